// SPDX-License-Identifier: Apache-2.0
// Rows that need other processes: a receiver beside a sender, and a whole measurement in a process
// of its own, so that a peer's library (its threads, its signal handlers, its memory) never enters
// the benchmark's process.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <string>

#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/futex.h"
#include "transport/doorbell.h"

#include "bench.h"

namespace xauto::bench {

inline constexpr std::int64_t kPauseNs = 1'000'000;  ///< between two messages

struct Shared {
  std::atomic<std::uint32_t> ready, done, quit;
  std::atomic<std::int64_t> arrived;
  transport::Doorbell doorbell;
  std::atomic<std::uint32_t> word;
};

/// Memory of this process and of those forked later.
template <class T>
class SharedMemory {
 public:
  explicit SharedMemory(std::size_t bytes = sizeof(T))
      : bytes_(bytes),
        at_(mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0)) {
    new (at_) T;
  }
  ~SharedMemory() { munmap(at_, bytes_); }
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;
  T& operator*() const { return *static_cast<T*>(at_); }
  T* operator->() const { return static_cast<T*>(at_); }

 private:
  std::size_t bytes_;
  void* at_;
};

/// `exit` rather than `_exit`: a peer's library gives back in its destructors what it has in
/// /dev/shm and /tmp.
inline pid_t child(const std::function<void()>& body) {
  const pid_t pid = fork();
  if (pid != 0) return pid;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  body();
  std::exit(0);
}

inline std::uint64_t touch(const std::byte* at, std::size_t bytes) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < bytes; i += 4096) sum += static_cast<std::uint64_t>(at[i]);
  return sum;
}

/// `send` publishes number k and says when it began; `receive` makes, in a process of its own, what
/// waits for one and touches it: true if one came. It returns at least every 100 ms.
template <class Send, class Receive>
Samples measure(const Options& options, Shared& shared, std::uint64_t rounds, Send send,
                Receive receive) {
  const Cores c = cores();
  const pid_t pid = child([&] {
    (void)rt::pin_to_core(c.second);
    rt::set_timer_slack_1ns();
    if (options.fifo) (void)rt::set_fifo(45);
    auto take = receive();
    shared.ready.store(1);
    while (shared.quit.load() == 0) {
      if (!take()) continue;
      shared.done.fetch_add(1);
      futex_wake(shared.done, 1);
    }
  });
  while (shared.ready.load() == 0) usleep(1000);
  (void)rt::pin_to_core(c.first);
  if (options.fifo) (void)rt::set_fifo(40);
  Samples samples;
  for (std::uint32_t k = 0; k < rounds; ++k) {
    sleep_until_ns(now_ns() + kPauseNs);
    const std::int64_t start = send(k);
    while (shared.done.load() == k) futex_wait(shared.done, k);
    if (k > 8) samples.add(shared.arrived.load() - start);
  }
  (void)rt::set_other();
  shared.quit.store(1);
  waitpid(pid, nullptr, 0);
  return samples;
}

/// `body` in a process of its own, on all cores and with ordinary priority to begin with. No
/// samples, and why on stderr, if it cannot or does not end within `limit_s`.
inline Samples in_process(const std::string& what, const std::function<Samples()>& body,
                          unsigned limit_s = 90) {
  int ends[2];
  Samples samples;
  if (pipe(ends) != 0) return samples;
  const pid_t pid = child([&] {
    close(ends[0]);
    alarm(limit_s);
    (void)rt::set_other();
    cpu_set_t all;
    CPU_ZERO(&all);
    for (const int core : {cores().first, cores().second})
      CPU_SET(static_cast<unsigned>(core), &all);
    (void)sched_setaffinity(0, sizeof all, &all);
    const Samples made = body();
    (void)rt::set_other();
    const auto* at = reinterpret_cast<const char*>(made.ns().data());
    for (std::size_t left = made.count() * sizeof(std::int64_t); left > 0;) {
      const ssize_t n = write(ends[1], at, left);
      if (n <= 0) break;
      at += n;
      left -= static_cast<std::size_t>(n);
    }
    close(ends[1]);
  });
  close(ends[1]);
  std::int64_t ns;
  while (read(ends[0], &ns, sizeof ns) == static_cast<ssize_t>(sizeof ns)) samples.add(ns);
  close(ends[0]);
  int status = 0;
  waitpid(pid, &status, 0);
  if (samples.count() == 0 || status != 0)
    fmt::print(stderr, "bench: {} was not measured{}\n", what,
               WIFSIGNALED(status) ? fmt::format(": signal {}", WTERMSIG(status)) : "");
  return status == 0 ? samples : Samples{};
}

}  // namespace xauto::bench

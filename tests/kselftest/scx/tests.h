// SPDX-License-Identifier: Apache-2.0
// A program of the scheduler's tests: its table of tests, and threads that wait for work.
#pragma once

#include <cstring>

#include <kselftest.h>
#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/clock.h"
#include "kernel/scx_scheduler.h"

#include "world.h"

namespace xauto::test {

inline void spin(const std::atomic<bool>& stop) {
  while (!stop.load(std::memory_order_relaxed)) asm volatile("");
}

inline void sleep_ms(int ms) {
  std::this_thread::sleep_for(std::chrono::milliseconds(ms));
}

/// An XNode thread that waits for work, as a worker of the runtime does.
class Waiter {
 public:
  Waiter(World& world, std::uint32_t xnode, std::function<void(const kernel::ThreadSlot&)> job)
      : thread_(world, xnode, [this, job = std::move(job)](const kernel::ThreadSlot& slot) {
          for (;;) {
            const std::uint32_t mail = mail_.load();
            if (mail == 2) return;
            if (mail == 0) {  // without a limit, unlike futex_wait: a test counts wake-ups
              syscall(SYS_futex, &mail_, FUTEX_WAIT, 0, nullptr, nullptr, 0);
              continue;
            }
            mail_.store(0);
            job(slot);
            done_.fetch_add(1);
          }
        }) {}
  ~Waiter() {
    mail_.store(2);
    syscall(SYS_futex, &mail_, FUTEX_WAKE, 1, nullptr, nullptr, 0);
    thread_.join();
  }
  void wake() {
    mail_.store(1);
    syscall(SYS_futex, &mail_, FUTEX_WAKE, 1, nullptr, nullptr, 0);
  }
  [[nodiscard]] std::uint32_t done() const { return done_.load(); }
  void tell(std::uint32_t xnode, std::uint64_t sequence) const {
    (void)thread_.slot().tell(xnode, sequence);
  }
  [[nodiscard]] std::uint32_t index() const { return thread_.index(); }
  /// Tells its next job for it, as the runtime does who hands a job over, and wakes it.
  void submit(std::uint32_t xnode, std::uint64_t sequence, const kernel::Told& told = {}) {
    wait_for([&] { return asleep(); });
    (void)thread_.slot().tell(xnode, sequence, told);
    wake();
  }

 private:
  [[nodiscard]] bool asleep() const {
    const std::string stat =
        slurp("/proc/self/task/" + std::to_string(thread_.slot().tid()) + "/stat");
    return stat.find(") S ") != std::string::npos;
  }
  std::atomic<std::uint32_t> mail_{0}, done_{0};
  XNodeThread thread_;
};

inline bool queued(const World& world, std::uint32_t slot) {
  return *const_cast<volatile const __u64*>(&world.maps.jobs()[slot].queued_ns) != 0;
}

struct Test {
  const char* name;
  int count;  ///< results
  void (*run)();
  bool at_once =
      false;  ///< needs CPUs that run at the same time: none where emulated ones take turns
};

/// Of `wanted`: "" for all, "turns" and "at-once" for those that do without such CPUs and the others,
/// else a part of the name.
inline bool is_wanted(const Test& test, const char* wanted) {
  if (strcmp(wanted, "turns") == 0) return !test.at_once;
  if (strcmp(wanted, "at-once") == 0) return test.at_once;
  return strstr(test.name, wanted) != nullptr;
}

/// Those of `wanted`. Ends the program.
template <std::size_t N>
static void run_tests(const Test (&tests)[N], const char* wanted) {
  int count = 0;
  for (const Test& test : tests) count += is_wanted(test, wanted) ? test.count : 0;
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(count);
  if (const std::string why = kernel::scx_refusal(""); !why.empty()) {
    for (int i = 0; i < count; ++i) ksft_test_result_skip("scheduler: %s\n", why.c_str());
    ksft_finished();
  }
  become_controller();
  for (const Test& test : tests) {
    if (!is_wanted(test, wanted)) continue;
    ksft_print_msg("%s\n", test.name);
    const std::int64_t since_ns = now_ns();
    test.run();
    ksft_print_msg("%s: %.1f s\n", test.name, static_cast<double>(now_ns() - since_ns) * 1e-9);
  }
  end_loaded_world();
  ksft_finished();
}

}  // namespace xauto::test

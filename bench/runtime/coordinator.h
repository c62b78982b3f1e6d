// SPDX-License-Identifier: Apache-2.0
// A coordinator (or anything else that serves) in a process of its own, as in a run.
#pragma once

#include <ctime>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include <signal.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/socket.h"
#include "coord/port.h"
#include "coord/server.h"

#include "bench.h"

namespace xauto::bench {

/// Another process that runs `body` until it is killed.
class Process {
 public:
  explicit Process(const std::function<void()>& body) : pid_(fork()) {
    if (pid_ != 0) return;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    body();
    _exit(0);
  }
  ~Process() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;
  [[nodiscard]] std::int64_t cpu_ns() const {
    clockid_t clock;
    clock_getcpuclockid(pid_, &clock);
    return clock_ns(clock);
  }

 private:
  pid_t pid_;
};

inline std::string next_address() {
  static int count = 0;
  return "xauto-bench/" + std::to_string(getpid()) + "-d" + std::to_string(count++) + "/x";
}

inline std::unique_ptr<Process> start_coordinator(const std::string& address, Discipline discipline,
                                                  int core, bool fifo, std::size_t xnodes = 64,
                                                  coord::OrderPairs order = {}) {
  auto process = std::make_unique<Process>([&] {
    (void)rt::pin_to_core(core);
    rt::set_timer_slack_1ns();
    rt::lock_memory();
    if (fifo) (void)rt::set_fifo(60);
    coord::ServerOptions options;
    options.address = address;
    options.xpu = "x";
    options.discipline = discipline;
    options.xnodes.assign(xnodes, "n");
    options.order = order;
    auto server = coord::Server::create(std::move(options));
    const int never = eventfd(0, EFD_CLOEXEC);
    if (server) (void)(*server)->run(never);
  });
  for (int i = 0; i < 500 && !connect_abstract(address); ++i) usleep(10'000);
  return process;
}

/// A worker's management thread: `obey` carries a command out and says whether it could.
class ManagementThread {
 public:
  ManagementThread(coord::Port& port, int core, bool fifo, std::function<bool(bool suspends)> obey)
      : port_(port), thread_([&port, core, fifo, obey = std::move(obey)] {
          (void)rt::pin_to_core(core);
          rt::set_timer_slack_1ns();
          if (fifo) (void)rt::set_fifo(50);
          for (;;) {
            const coord::Command command = port.wait_command();
            if (command == coord::Command::kInterrupted) return;
            port.acknowledge(obey(command == coord::Command::kSuspend));
          }
        }) {}
  ~ManagementThread() {
    port_.interrupt();
    thread_.join();
  }
  ManagementThread(const ManagementThread&) = delete;
  ManagementThread& operator=(const ManagementThread&) = delete;

 private:
  coord::Port& port_;
  std::thread thread_;
};

}  // namespace xauto::bench

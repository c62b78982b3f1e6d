// SPDX-License-Identifier: Apache-2.0
#include "base/daemon.h"

#include <signal.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "base/log.h"
#include "base/rt.h"

namespace xauto::daemon {

UniqueFd stop_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigprocmask(SIG_BLOCK, &signals, nullptr);
  return UniqueFd(signalfd(-1, &signals, SFD_CLOEXEC));
}

void settle(const std::string& name, int priority) {
  rt::set_timer_slack_1ns();
  if (const Status status = rt::set_fifo_up_to(priority); !status)
    log::debug("{}: {}", name, status.error().to_string());
  rt::lock_memory();
}

void tell_ready(int fd) {
  if (fd < 0) return;
  [[maybe_unused]] const ssize_t told = write(fd, "ready\n", 6);
  close(fd);
}

}  // namespace xauto::daemon

// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 6: the management thread. It sleeps until the coordinator has a command for
// this worker, carries it out through the XPU's backend, and acknowledges.
#include "base/log.h"
#include "base/rt.h"
#include "runtime/worker.h"

namespace xauto::runtime {

void Worker::manage() {
  rt::set_thread_name(options_.name + "/m");
  rt::set_timer_slack_1ns();
  // Not fatal: the coordinator of a user without real-time permission does its best, as doctor
  // says.
  if (options_.mgmt_fifo > 0) (void)rt::set_fifo(options_.mgmt_fifo);

  // What we suspended, by value: the execution thread may be at its next job when RESUME comes.
  std::optional<SchedHandle> suspended;
  for (;;) {
    const coord::Command command = port_->wait_command(suspended ? xpu::kStillWantedMs : -1);
    const Placed* job = current_.load(std::memory_order_acquire);
    switch (command) {
      case coord::Command::kSuspend: {
        record(XAUTO_EV_SUSPEND, *job);
        const Status done = backend_->preempt(job->handle);
        if (done) {
          suspended = job->handle;
          record(XAUTO_EV_SUSPENDED, *job);
        } else {
          log::debug("{}: not suspended: {}", options_.name, done.error().to_string());
        }
        port_->acknowledge(done.has_value());
        break;
      }
      case coord::Command::kResume:
        record(XAUTO_EV_RESUME, *job);
        if (suspended) {
          if (const Status done = backend_->restore(*suspended); !done)
            log::warn("{}: not resumed: {}", options_.name, done.error().to_string());
          suspended.reset();
        }
        record(XAUTO_EV_RESUMED, *job);
        port_->acknowledge(true);
        break;
      case coord::Command::kNothing:
        if (const Status fed = backend_->still_wanted(); !fed)
          log::warn("{}: runs although the coordinator suspended it: {}", options_.name,
                    fed.error().to_string());
        break;
      case coord::Command::kLost:
      case coord::Command::kInterrupted:
        if (suspended) (void)backend_->restore(*suspended);
        suspended.reset();
        if (command == coord::Command::kInterrupted) return;
        lost_.store(true);
        log::warn("{}: the coordinator of {} is gone: its jobs go on unscheduled", options_.name,
                  options_.xpu_id.name);
        break;
    }
  }
}

}  // namespace xauto::runtime

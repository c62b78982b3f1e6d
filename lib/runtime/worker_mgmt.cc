// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 6: the management thread. It sleeps until there is a command for this worker,
// from a more urgent job or from the coordinator. It carries it out through the XPU's backend, and
// acknowledges.
#include <algorithm>
#include <utility>

#include "base/clock.h"
#include "base/counter.h"
#include "base/log.h"
#include "base/rt.h"
#include "runtime/held_up.h"
#include "runtime/worker.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kStuckCallNs = 1'000'000'000;
constexpr int kLookMs = static_cast<int>(kHeldUpLookNs / 1'000'000);

}  // namespace

/// What is suspended, by value: the execution thread may be at its next job when RESUME comes.
struct Worker::Suspended {
  SchedHandle handle;
  const Placed* job;
  std::uint64_t sequence;
  std::optional<HeldUp::Watch> holds_up = {};
  std::int64_t told_ns = 0;  ///< the backend: that it shall stay so
};

void Worker::manage() {
  rt::set_thread_name(options_.name + "/m");
  rt::set_timer_slack_1ns();
  // Not fatal: the coordinator of a user without real-time permission does its best, as doctor
  // says.
  if (options_.mgmt_fifo > 0) (void)rt::set_fifo(options_.mgmt_fifo);
  std::optional<Suspended> suspended;
  for (;;) {
    const int again_ms = backend_->again_ms(suspended.has_value());
    const coord::Command command = port_->wait_command(
        suspended && suspended->holds_up ? std::min(kLookMs, again_ms) : again_ms);
    switch (command) {
      case coord::Command::kSuspend:
        carry_out_suspend(suspended);
        break;
      case coord::Command::kResume:
        carry_out_resume(suspended);
        break;
      case coord::Command::kNothing:
        look_at_suspended(suspended, again_ms);
        break;
      case coord::Command::kInterrupted:
        return let_run_alone(suspended);
      case coord::Command::kLost:
        let_run_alone(suspended);
        lost_.store(true);
        log::warn("{}: the coordinator of {} is gone: its jobs go on unscheduled", options_.name,
                  xpu_name());
        break;
    }
  }
}

void Worker::carry_out_suspend(std::optional<Suspended>& suspended) {
  // Said twice: what the execution thread is at may be the next job.
  if (suspended) return port_->acknowledge(true);
  const std::uint64_t current = current_.load(std::memory_order_acquire);
  const Placed* job = &chain_.nodes[current >> kSequenceBits];
  const std::uint64_t sequence = current & ((std::uint64_t{1} << kSequenceBits) - 1);
  record(XAUTO_EV_SUSPEND, *job, sequence);
  const std::int64_t asked = now_ns();
  const Status done = suspend(*job);
  if (done) {
    const std::int64_t now = now_ns();
    suspended.emplace(Suspended{job->here->made.handle, job, sequence, {}, now});
    if (options_.held_up != nullptr) suspended->holds_up.emplace(*options_.held_up, job->node, now);
    // What this call takes is the cost of the preemption, which the one that preempts is charged.
    times_.away(asked);
    if (options_.counts != nullptr) {
      options_.counts->suspensions.fetch_add(1, std::memory_order_relaxed);
      keep_largest(options_.counts->longest_suspend_ns, now - asked);
    }
    thread_->gave_xpu(now);
    record(XAUTO_EV_SUSPENDED, *job, sequence);
  } else {
    tell_failed(*job, true, done.error().to_string());
  }
  port_->acknowledge(done.has_value());
}

/// Where nothing is suspended it is back before we came to suspend it, or could not be.
void Worker::carry_out_resume(std::optional<Suspended>& suspended) {
  if (suspended) {
    record(XAUTO_EV_RESUME, *suspended->job, suspended->sequence);
    const std::int64_t asked = now_ns();
    if (const Status done = resume(*suspended->job, suspended->handle); !done)
      tell_failed(*suspended->job, false, done.error().to_string());
    const std::int64_t now = now_ns();
    if (options_.counts != nullptr) keep_largest(options_.counts->longest_resume_ns, now - asked);
    times_.back(now);
    thread_->has_xpu(now);
    record(XAUTO_EV_RESUMED, *suspended->job, suspended->sequence);
    suspended.reset();
  }
  port_->acknowledge(true);
}

/// Whether it holds up a more urgent job; and tells the backend again that it shall stay so.
void Worker::look_at_suspended(std::optional<Suspended>& suspended, int again_ms) {
  if (suspended && suspended->holds_up) {
    const std::int64_t now = now_ns();
    const auto job = port_->begun(suspended->job->task, suspended->sequence);
    if (const auto waits = job ? suspended->holds_up->look(now, job->key) : std::nullopt) {
      tell_held_up(*suspended->job, suspended->sequence, waits->xnode);
      port_->lend(*job, waits->key);
    }
    if (now - suspended->told_ns < std::int64_t{again_ms - kLookMs} * 1'000'000) return;
    suspended->told_ns = now;
  }
  if (const Status fed = backend_->still_wanted(); !fed)
    log::warn("{}: has run although the coordinator suspended it: {}", options_.name,
              fed.error().to_string());
}

/// Nobody schedules any more.
void Worker::let_run_alone(std::optional<Suspended>& suspended) {
  if (suspended) (void)resume(*suspended->job, suspended->handle);
  suspended.reset();
  times_.back(now_ns());
}

/// May never return: `stop` then says of whom.
Status Worker::suspend(const Placed& placed) {
  calls_.begin(CallWatch::Call::kSuspend, placed, now_ns());
  const Status done = backend_->preempt(placed.here->made.handle);
  calls_.end();
  return done;
}

Status Worker::resume(const Placed& placed, const SchedHandle& handle) {
  calls_.begin(CallWatch::Call::kResume, placed, now_ns());
  const Status done = backend_->restore(handle);
  calls_.end();
  return done;
}

void Worker::tell_stuck_call(std::int64_t now_ns) {
  if (const auto stuck = calls_.stuck(now_ns, kStuckCallNs))
    tell_failed(*stuck->placed, stuck->call == CallWatch::Call::kSuspend,
                "it has not returned for a second");
}

/// Nobody but the report and whoever looks hears of it: the job that is more urgent waits, or its XPU stands still.
void Worker::tell_failed(const Placed& placed, bool suspend, const std::string& why) {
  bool first = true;
  if (XNodeLine* line = placed.line; line != nullptr) {
    line->failed_on.store(static_cast<std::uint32_t>(options_.xpu));
    first = (suspend ? line->failed_suspends : line->failed_resumes).fetch_add(1) == 0;
  }
  if (first)
    log::warn("the work of XNode '{}' was not {} on {}: {} (further failures are only counted)",
              placed.name, suspend ? "suspended for a more urgent job" : "resumed", xpu_name(),
              why);
}

/// Before the coordinator resumes it, so that the trace tells them in this order.
void Worker::tell_held_up(const Placed& placed, std::uint64_t sequence, std::uint32_t who) {
  record(XAUTO_EV_HELD_UP, placed, sequence, who);
  if (options_.contexts != nullptr && options_.contexts->held_up.fetch_add(1) > 0) return;
  log::warn(
      "XNode '{}' was suspended on {} while the more urgent '{}' waits for its work, so it "
      "got that one's urgency: an exec returns once its work is over, see docs/api.md "
      "(further ones are only counted)",
      placed.name, xpu_name(), options_.held_up->name(who));
}

void Worker::tell_moved() const {
  if (given_.cpus.empty() || ended_.load() != 0) return;
  const rt::Placement now = rt::placement_of(times_.thread_id());
  if (now.cpus.empty() || now == given_) return;
  for (const Placed& placed : chain_.nodes)
    if (placed.worker == this) {
      placed.line->moved.fetch_add(1, std::memory_order_relaxed);
      return;
    }
}

}  // namespace xauto::runtime

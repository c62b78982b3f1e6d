// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 6: the management thread. It sleeps until there is a command for this worker,
// from a more urgent job or from the coordinator. It carries it out through the XPU's backend, and
// acknowledges. Also how long jobs have had their XPU, and what there is to do about limits (stopwatch.h).
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

constexpr const char *kSuspendCall = "suspend", *kResumeCall = "resume";
constexpr std::int64_t kStuckCallNs = 1'000'000'000;
constexpr std::int64_t kWorthTellingNs = 50'000;  ///< to the trace: shorter ones explain nothing

}  // namespace

void Worker::manage() {
  rt::set_thread_name(options_.name + "/m");
  rt::set_timer_slack_1ns();
  // Not fatal: the coordinator of a user without real-time permission does its best, as doctor
  // says.
  if (options_.mgmt_fifo > 0) (void)rt::set_fifo(options_.mgmt_fifo);

  // What we suspended, by value: the execution thread may be at its next job when RESUME comes.
  struct Suspended {
    SchedHandle handle;
    const Placed* job;
    std::uint64_t sequence;
    std::optional<HeldUp::Watch> holds_up = {};
    std::int64_t told_ns = 0;  ///< the backend: that it shall stay so
  };
  std::optional<Suspended> suspended;
  for (;;) {
    constexpr int kLookMs = static_cast<int>(kHeldUpLookNs / 1'000'000);
    const int again_ms = backend_->again_ms(suspended.has_value());
    const coord::Command command = port_->wait_command(
        suspended && suspended->holds_up ? std::min(kLookMs, again_ms) : again_ms);
    switch (command) {
      case coord::Command::kSuspend: {
        if (suspended) {  // said twice; what the execution thread is at may be the next job
          port_->acknowledge(true);
          break;
        }
        const std::uint64_t current = current_.load(std::memory_order_acquire);
        const Placed* job = &chain_.nodes[current >> kSequenceBits];
        const std::uint64_t sequence = current & ((std::uint64_t{1} << kSequenceBits) - 1);
        record(XAUTO_EV_SUSPEND, *job, sequence);
        const std::int64_t asked = now_ns();
        const Status done = suspend(*job);
        if (done) {
          const std::int64_t now = now_ns();
          suspended.emplace(Suspended{job->here->made.handle, job, sequence, {}, now});
          if (options_.held_up != nullptr)
            suspended->holds_up.emplace(*options_.held_up, job->node, now);
          // What this call takes is the cost of the preemption, which the one that preempts is charged.
          watch_.away(asked);
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
        break;
      }
      case coord::Command::kResume:
        if (suspended) {  // otherwise it is back before we came to suspend it, or could not be
          record(XAUTO_EV_RESUME, *suspended->job, suspended->sequence);
          const std::int64_t asked = now_ns();
          if (const Status done = resume(*suspended->job, suspended->handle); !done)
            tell_failed(*suspended->job, false, done.error().to_string());
          const std::int64_t now = now_ns();
          if (options_.counts != nullptr)
            keep_largest(options_.counts->longest_resume_ns, now - asked);
          watch_.back(now);
          thread_->has_xpu(now);
          record(XAUTO_EV_RESUMED, *suspended->job, suspended->sequence);
          suspended.reset();
        }
        port_->acknowledge(true);
        break;
      case coord::Command::kNothing:
        if (suspended && suspended->holds_up) {
          const std::int64_t now = now_ns();
          const auto job = port_->begun(suspended->job->task, suspended->sequence);
          if (const auto waits = job ? suspended->holds_up->look(now, job->key) : std::nullopt) {
            tell_held_up(*suspended->job, suspended->sequence, waits->xnode);
            port_->lend(*job, waits->key);
          }
          if (now - suspended->told_ns < std::int64_t{again_ms - kLookMs} * 1'000'000) break;
          suspended->told_ns = now;
        }
        if (const Status fed = backend_->still_wanted(); !fed)
          log::warn("{}: has run although the coordinator suspended it: {}", options_.name,
                    fed.error().to_string());
        break;
      case coord::Command::kLost:
      case coord::Command::kInterrupted:
        if (suspended) (void)resume(*suspended->job, suspended->handle);
        suspended.reset();
        watch_.back(now_ns());
        if (command == coord::Command::kInterrupted) return;
        lost_.store(true);
        log::warn("{}: the coordinator of {} is gone: its jobs go on unscheduled", options_.name,
                  xpu_name());
        break;
    }
  }
}

/// May never return: `stop` then says of whom.
Status Worker::suspend(const Placed& placed) {
  call_for_.store(&placed);
  call_since_ns_.store(now_ns());
  call_.store(kSuspendCall);
  const Status done = backend_->preempt(placed.here->made.handle);
  call_.store(nullptr);
  return done;
}

Status Worker::resume(const Placed& placed, const SchedHandle& handle) {
  call_for_.store(&placed);
  call_since_ns_.store(now_ns());
  call_.store(kResumeCall);
  const Status done = backend_->restore(handle);
  call_.store(nullptr);
  return done;
}

void Worker::tell_stuck_call(std::int64_t now_ns) {
  const char* call = call_.load();
  const std::int64_t since_ns = call_since_ns_.load();
  if (call == nullptr || since_ns == told_call_ns_ || now_ns - since_ns <= kStuckCallNs) return;
  told_call_ns_ = since_ns;
  tell_failed(*call_for_.load(), call == kSuspendCall, "it has not returned for a second");
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

// ---- times -------------------------------------------------------------------------------------

void Worker::begin_timed(const Placed& placed, std::uint64_t sequence) {
  timed_.store(&placed, std::memory_order_release);
  if (backend_->on_thread() && placed.limited) {
    without_core_since_ns_.store(rt::without_core_ns().value_or(-1));
    if (placed.limits.wcet_ns > 0 || placed.watched || without_core_since_ns_.load() < 0)
      cpu_since_ns_.store(clock_ns(cpu_clock_));
  }
  watch_.begin(now_ns(), sequence);
}

/// Of the `ran_ns` of its job until `now_ns`: without what it was on the XPU beside the one from whom it got
/// it, which is the cost of a preemption; no more than the platform says that one costs.
std::int64_t Worker::own_ns(std::int64_t ran_ns, std::int64_t now_ns) const {
  if (!port_ || options_.preempt_ns == 0) return ran_ns;
  const std::int64_t beside_ns = port_->beside_ns(watch_.since_ns(), now_ns);
  return std::max<std::int64_t>(0, ran_ns - std::min(beside_ns, options_.preempt_ns));
}

/// Of a job on a real core, whom the kernel preempts unseen: all of its time but for what it waited in a
/// run queue. A WCET was measured so, with nobody to wait for: an exec that sleeps for a lock or a file
/// is on its core.
std::int64_t Worker::on_core_ns(const Placed& placed, std::int64_t wall_ns) {
  const std::int64_t since_ns = without_core_since_ns_.load();
  if (since_ns < 0) return clock_ns(cpu_clock_) - cpu_since_ns_.load();
  const std::int64_t until_ns = rt::without_core_ns().value_or(since_ns);
  tell_waited(until_ns, *placed.line);
  const std::int64_t others_ns = until_ns - since_ns;
  if (others_ns >= kWorthTellingNs)
    record(XAUTO_EV_NO_CORE, placed, chain_.activation->sequence(),
           static_cast<std::uint32_t>(std::min<std::int64_t>(others_ns / 1000, UINT32_MAX)));
  return std::max<std::int64_t>(0, wall_ns - others_ns);
}

/// Since the job before, its wake-up included. Who is more urgent on its core has slept before it runs again,
/// and told its CPU time then: what is left, nobody of this run had.
void Worker::tell_waited(std::int64_t without_core_ns, XNodeLine& line) {
  if (options_.counts == nullptr) return;
  const std::int64_t others_ns = options_.counts->busy_ns.load() - cpu_told_ns_;
  const std::int64_t waited_ns =
      without_core_ns - std::exchange(waited_before_ns_, without_core_ns);
  const std::int64_t by_others_ns = others_ns - std::exchange(others_before_ns_, others_ns);
  keep_largest(line.waited_ns, waited_ns - std::max<std::int64_t>(0, by_others_ns));
}

void Worker::tell_moved() const {
  if (given_.cpus.empty() || ended_.load() != 0) return;
  const rt::Placement now = rt::placement_of(tid_);
  if (now.cpus.empty() || now == given_) return;
  for (const Placed& placed : chain_.nodes)
    if (placed.worker == this) {
      placed.line->moved.fetch_add(1, std::memory_order_relaxed);
      return;
    }
}

/// False: the activation was given up meanwhile.
bool Worker::end_timed(const Placed& placed) {
  const std::int64_t now = now_ns();
  const std::uint64_t job = watch_.job();
  const std::int64_t wall_ns = watch_.end(now);
  if (holds_) options_.counts->busy_ns.fetch_add(wall_ns, std::memory_order_relaxed);
  if (!placed.limited) return true;
  const std::int64_t took_ns =
      backend_->on_thread() ? on_core_ns(placed, wall_ns) : own_ns(wall_ns, now);
  XNodeLine& line = *placed.line;  // of the module's workers on this XPU
  if (placed.watched) line.saw(took_ns, placed.table);
  line.jobs.fetch_add(1, std::memory_order_relaxed);
  if (placed.limits.budget_ns > 0 && took_ns > placed.limits.budget_ns)
    line.overruns.fetch_add(1, std::memory_order_relaxed);
  // By the certificate a job has its WCET from its hold on: being woken late takes of it.
  const std::int64_t charged_ns = took_ns + overslept_ns_;
  const std::int64_t wcet_ns = placed.limits.wcet_ns, hang_ns = placed.limits.hang_ns;
  // From here on nobody tells that it has not ended.
  const bool told = past_job_.exchange(job + 1) == job;
  if (told || (wcet_ns > 0 && charged_ns > wcet_ns)) {
    if (!placed.watched)
      line.over(1, std::max<std::int64_t>(0, charged_ns - wcet_ns));
    else if (hang_ns == 0 || wall_ns <= hang_ns)  // else its XPU counts as lost
      line.past(charged_ns, placed.table);
  }
  if (told) line.ended();
  keep_largest(line.longest_ns, charged_ns);
  return !chain_.activation->abandoned();
}

/// By another thread, so on a real core only what it has run for: what waits in a run queue now is not
/// counted there yet. What it slept is told when it ends.
void Worker::tell_time(std::int64_t now_ns) const {
  const auto seen = watch_.look(now_ns);
  if (!seen || seen->job == hung_job_.load(std::memory_order_relaxed)) return;  // that is told
  const Placed* placed = timed_.load(std::memory_order_acquire);
  const std::int64_t took_ns = backend_->on_thread() ? clock_ns(cpu_clock_) - cpu_since_ns_.load()
                                                     : own_ns(seen->took_ns, now_ns);
  // `placed` and the times belong together only if that job still runs.
  const auto again = watch_.look(now_ns);
  if (again && again->job == seen->job && placed->watched)
    placed->line->saw(took_ns, placed->table);
}

/// By another thread: no more than what it will be charged with. On a real core only what it has run for, as
/// long as it has or wants one.
std::int64_t Worker::so_far_ns(const Stopwatch::Look& seen, std::int64_t now_ns) const {
  if (!backend_->on_thread()) return own_ns(seen.took_ns, now_ns);
  const std::int64_t since_ns = without_core_since_ns_.load();
  const auto until_ns = since_ns < 0 ? std::nullopt : rt::without_core_ns(tid_);
  if (!until_ns) return clock_ns(cpu_clock_) - cpu_since_ns_.load();
  return std::max<std::int64_t>(0, seen.took_ns - (*until_ns - since_ns));
}

void Worker::tell_past_wcet(std::int64_t now_ns) {
  std::uint64_t told = past_job_.load();  // before the look: of what ends meanwhile it is another
  const auto seen = watch_.look(now_ns);
  if (!seen) return;
  const Placed* placed = timed_.load(std::memory_order_acquire);
  const std::int64_t wcet_ns = placed->limits.wcet_ns;
  if (wcet_ns <= 0 || placed->watched || seen->took_ns <= wcet_ns) return;
  const std::int64_t took_ns = so_far_ns(*seen, now_ns);
  const auto again = watch_.look(now_ns);
  if (took_ns <= wcet_ns || !again || again->job != seen->job) return;
  XNodeLine& line = *placed->line;
  if (told != seen->job) {
    line.unended.fetch_add(1);
    if (!past_job_.compare_exchange_strong(told, seen->job)) return line.ended();
  }
  line.unended_wcet_ns.store(wcet_ns);
  keep_largest(line.unended_ns, took_ns);
}

std::optional<Worker::Hung> Worker::find_hung(std::int64_t now_ns) {
  const auto seen = watch_.look(now_ns);
  if (!seen || seen->job == hung_job_.load(std::memory_order_relaxed)) return std::nullopt;
  const Placed* placed = timed_.load(std::memory_order_acquire);
  if (placed->limits.hang_ns <= 0 || seen->took_ns <= placed->limits.hang_ns) return std::nullopt;
  // timed_ belongs to the job that was seen only if that one still runs.
  const auto again = watch_.look(now_ns);
  if (!again || again->job != seen->job) return std::nullopt;
  hung_job_.store(seen->job, std::memory_order_relaxed);
  placed->line->hung_table.store(placed->table);
  placed->line->hangs.fetch_add(1);
  return Hung{placed, seen->sequence, chain_.module};
}

}  // namespace xauto::runtime

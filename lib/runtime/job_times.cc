// SPDX-License-Identifier: Apache-2.0
#include "runtime/job_times.h"

#include <algorithm>
#include <utility>

#include <pthread.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/counter.h"
#include "base/rt.h"

namespace xauto::runtime {
namespace {

/// A job of another process tells so often for how long it has run. The hub looks itself, at the instant that counts.
constexpr std::int64_t kTellNs = 1'000'000;

}  // namespace

void JobTimes::of_this_thread() {
  (void)pthread_getcpuclockid(pthread_self(), &cpu_clock_);
  tid_ = gettid();
}

/// Not what the inits took.
void JobTimes::before_jobs() {
  cpu_told_ns_ = clock_ns(cpu_clock_);
  if (on_.on_thread) waited_before_ns_ = rt::without_core_ns().value_or(0);
}

void JobTimes::begin(const Placed& placed, std::uint64_t sequence) {
  timed_.store(&placed, std::memory_order_release);
  if (on_.on_thread && placed.limited) {
    without_core_since_ns_.store(rt::without_core_ns().value_or(-1));
    if (placed.limits.wcet_ns > 0 || placed.watched || without_core_since_ns_.load() < 0)
      cpu_since_ns_.store(clock_ns(cpu_clock_));
  }
  const std::int64_t now = now_ns();
  if (by_levels()) {
    const auto job = on_.counts->above.begin(on_.port->level(), now, placed.limits.wcet_ns);
    level_.store(job.level);
    before_ns_.store(job.before_ns);
  }
  watch_.begin(now, sequence);
  if (alarm_ && placed.watched) alarm_->by(now + placed.limits.tell_ns);
}

bool JobTimes::by_levels() const {
  return holds() && on_.port != nullptr && on_.port->discipline() == Discipline::kLevels;
}

/// Of the `ran_ns` of its job until `now_ns`: without what it was on the XPU beside the one from whom it got
/// it, which is the cost of a preemption; no more than the platform says that one costs. By levels, without what
/// jobs above it had.
std::int64_t JobTimes::own_ns(std::int64_t ran_ns, std::int64_t now_ns) const {
  if (by_levels())
    return std::max<std::int64_t>(0, ran_ns - on_.counts->above.above_ns(begun(), now_ns));
  if (on_.port == nullptr || on_.preempt_ns == 0) return ran_ns;
  const std::int64_t beside_ns = on_.port->beside_ns(watch_.since_ns(), now_ns);
  return std::max<std::int64_t>(0, ran_ns - std::min(beside_ns, on_.preempt_ns));
}

/// Of a job on a real core, whom the kernel preempts unseen: all of its time but for what it waited in a
/// run queue. A WCET was measured so, with nobody to wait for: an exec that sleeps for a lock or a file
/// is on its core.
std::int64_t JobTimes::on_core_ns(std::int64_t wall_ns, XNodeLine& line, Without& without) {
  const std::int64_t since_ns = without_core_since_ns_.load();
  if (since_ns < 0) return clock_ns(cpu_clock_) - cpu_since_ns_.load();
  const std::int64_t until_ns = rt::without_core_ns().value_or(since_ns);
  without.foreign_ns = tell_waited(until_ns, line);
  without.core_ns = until_ns - since_ns;
  return std::max<std::int64_t>(0, wall_ns - without.core_ns);
}

/// Since the job before, its wake-up included. Who is more urgent on its core has slept before it runs again,
/// and told its CPU time then: what is left, nobody of this run had.
std::int64_t JobTimes::tell_waited(std::int64_t without_core_ns, XNodeLine& line) {
  if (on_.counts == nullptr) return 0;
  const std::int64_t others_ns =
      on_.counts->busy_ns.load() - cpu_told_ns_ + (on_.shared ? on_.port->others_had_ns() : 0);
  const std::int64_t waited_ns =
      without_core_ns - std::exchange(waited_before_ns_, without_core_ns);
  const std::int64_t by_others_ns = others_ns - std::exchange(others_before_ns_, others_ns);
  const std::int64_t foreign_ns = waited_ns - std::max<std::int64_t>(0, by_others_ns);
  keep_largest(line.waited_ns, foreign_ns);
  return std::max<std::int64_t>(0, foreign_ns);
}

std::int64_t JobTimes::end(const Placed& placed) {
  Without without;
  const std::int64_t now = now_ns();
  const std::uint64_t job = watch_.job();
  const std::int64_t wall_ns = watch_.end(now);
  const bool levels = by_levels();
  const std::int64_t had_ns = levels ? own_ns(wall_ns, now) : wall_ns;
  if (levels) on_.counts->above.end(begun(), now);
  if (holds()) on_.counts->busy_ns.fetch_add(had_ns, std::memory_order_relaxed);
  if (on_.shared) on_.port->tell_had(watch_.since_ns(), now, wall_ns);
  if (!placed.limited) return without.core_ns;
  const std::int64_t took_ns = on_.on_thread ? on_core_ns(wall_ns, *placed.line, without)
                               : levels      ? had_ns
                                             : own_ns(wall_ns, now);
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
  // Time that strangers take of the XPU is within the certificate as long as the job's WCET covers it, too.
  if (wcet_ns > 0 && !placed.watched && charged_ns <= wcet_ns &&
      charged_ns + without.foreign_ns > wcet_ns)
    on_.counts->crowd(without.foreign_ns, on_.shared);
  if (told) line.ended();
  keep_largest(line.longest_ns, charged_ns);
  return without.core_ns;
}

/// Before it sleeps, where it costs no job anything.
void JobTimes::tell_cpu_time() {
  if (holds() || on_.counts == nullptr) return;
  const std::int64_t cpu_ns = clock_ns(cpu_clock_);
  on_.counts->busy_ns.fetch_add(cpu_ns - std::exchange(cpu_told_ns_, cpu_ns),
                                std::memory_order_relaxed);
}

/// By another thread, so on a real core only what it has run for: what waits in a run queue now is not
/// counted there yet. What it slept is told when it ends.
/// What is shorter than any scenario allows nobody needs to know before the job ends.
void JobTimes::tell_time(std::int64_t now_ns) const {
  const auto seen = watch_.look(now_ns);
  if (!seen || seen->job == hung_job_.load(std::memory_order_relaxed)) return;  // that is told
  const Placed* placed = timed_.load(std::memory_order_acquire);
  const std::int64_t took_ns =
      on_.on_thread ? clock_ns(cpu_clock_) - cpu_since_ns_.load() : own_ns(seen->took_ns, now_ns);
  // `placed` and the times belong together only if that job still runs.
  const auto again = watch_.look(now_ns);
  if (!again || again->job != seen->job || !placed->watched) return;
  const std::int64_t left_ns = placed->limits.tell_ns - took_ns;
  if (left_ns <= 0) placed->line->saw(took_ns, placed->table);
  if (alarm_) alarm_->by(now_ns + std::max(left_ns, kTellNs));
}

/// By another thread: no more than what it will be charged with. On a real core only what it has run for, as
/// long as it has or wants one.
std::int64_t JobTimes::so_far_ns(const Stopwatch::Look& seen, std::int64_t now_ns) const {
  if (!on_.on_thread) return own_ns(seen.took_ns, now_ns);
  const std::int64_t since_ns = without_core_since_ns_.load();
  const auto until_ns = since_ns < 0 ? std::nullopt : rt::without_core_ns(tid_);
  if (!until_ns) return clock_ns(cpu_clock_) - cpu_since_ns_.load();
  return std::max<std::int64_t>(0, seen.took_ns - (*until_ns - since_ns));
}

void JobTimes::tell_past_wcet(std::int64_t now_ns) {
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

std::optional<JobTimes::Hung> JobTimes::find_hung(std::int64_t now_ns) {
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
  return Hung{placed, seen->sequence};
}

}  // namespace xauto::runtime

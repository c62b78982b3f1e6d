// SPDX-License-Identifier: Apache-2.0
// How long a job has had its XPU.
//
// The time of a job runs from the moment when it may run until its exec returns, less the time for
// which it was suspended for others, or was being, and less the time until the one from whom it got the
// XPU was suspended, up to the platform's preempt_us: that is the preemption's. Where the hardware preempts by
// levels, less what jobs above it had (processes/jobs_above.h). On a real CPU, where the
// kernel takes the XPU away unseen, budgets count the thread's CPU time; hangs always count wall time,
// since whoever waits for a lock uses none.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

namespace xauto::runtime {

/// Of one worker. Time comes from outside, so that tests need none.
class Stopwatch {
 public:
  /// Execution thread. `end` returns the time that the job took.
  void begin(std::int64_t now_ns, std::uint64_t sequence);
  std::int64_t end(std::int64_t now_ns);
  /// Management thread: the job has lost its XPU, has it back.
  void away(std::int64_t now_ns) { away_since_.store(now_ns); }
  void back(std::int64_t now_ns);

  struct Look {
    std::uint64_t job;  ///< counts jobs
    std::uint64_t sequence;
    std::int64_t took_ns;
  };
  /// Any thread: when the job that runs, or ran last, began.
  [[nodiscard]] std::int64_t since_ns() const { return since_.load(std::memory_order_relaxed); }
  /// Execution thread: as Look::job has the one that runs.
  [[nodiscard]] std::uint64_t job() const { return job_.load(std::memory_order_relaxed); }
  /// Any thread: the job that runs now, if one does.
  [[nodiscard]] std::optional<Look> look(std::int64_t now_ns) const;

 private:
  [[nodiscard]] std::int64_t took(std::int64_t now_ns) const;
  std::atomic<std::uint64_t> job_{0};  ///< odd: it runs
  std::atomic<std::uint64_t> sequence_{0};
  std::atomic<std::int64_t> since_{0};
  std::atomic<std::int64_t> away_ns_{0};     ///< of this job, until away_since_
  std::atomic<std::int64_t> away_since_{0};  ///< 0: it has its XPU
};

}  // namespace xauto::runtime

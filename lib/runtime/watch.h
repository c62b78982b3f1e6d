// SPDX-License-Identifier: Apache-2.0
// Budgets and hangs: how long a job has had its XPU, who exceeded what it may take, and the thread
// that notices jobs which do not return.
//
// The time of a job runs from the moment when it may run until its exec returns, less the time for
// which it was suspended for others, or was being, and less the time until the one from whom it got the
// XPU was suspended, up to the platform's preempt_us: that is the preemption's. On a real CPU, where the
// kernel takes the XPU away unseen, budgets count the thread's CPU time; hangs always count wall time,
// since whoever waits for a lock uses none.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "model/deployment.h"

namespace xauto::runtime {

struct XNodeLine;

/// What the jobs of one XNode may take; 0: no limit.
struct Limits {
  std::int64_t budget_ns = 0, hang_ns = 0;
  /// The policy claims worst cases of jobs that take no longer. With tables: in each scenario that the
  /// table serves; of longer ones the scenario in force decides (table_switch.h).
  std::int64_t wcet_ns = 0;
  OnHang on_hang = OnHang::kLog;
  [[nodiscard]] bool any() const { return budget_ns > 0 || hang_ns > 0 || wcet_ns > 0; }

  /// Of an XNode whose WCET on its XPU is `wcet_us`.
  [[nodiscard]] static Limits of(const Deployment& deployment, const std::string& module,
                                 const std::string& xnode, std::int64_t wcet_us);
};

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

/// Calls `look` every `period_ns` on a thread of its own.
class Watchdog {
 public:
  /// kUnavailable: there is none.
  [[nodiscard]] static Result<std::unique_ptr<Watchdog>> start(
      std::int64_t period_ns, std::function<void(std::int64_t now_ns)> look);
  ~Watchdog() { stop(); }
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;
  void stop();

 private:
  Watchdog() = default;
  std::atomic<std::uint32_t> quit_{0};  ///< a futex
  std::thread thread_;
};

}  // namespace xauto::runtime

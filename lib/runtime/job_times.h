// SPDX-License-Identifier: Apache-2.0
// How long the jobs of one worker have had their XPU (stopwatch.h), as the board is told: when a job ends, and while
// one runs that may never end.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>

#include <sys/types.h>
#include <time.h>

#include "base/alarm.h"
#include "coord/port.h"
#include "processes/board.h"
#include "runtime/placed.h"
#include "runtime/stopwatch.h"

namespace xauto::runtime {

/// Threads: the execution thread, apart from what says otherwise.
class JobTimes {
 public:
  struct On {
    XpuLine* counts = nullptr;          ///< of its XPU; null: nobody can look at it
    const coord::Port* port = nullptr;  ///< null: nobody schedules
    std::int64_t preempt_ns = 0;        ///< what taking the XPU from another costs
    bool on_thread = false;             ///< the work of its jobs is its thread, on a core
    bool shared = false;                ///< jobs of other runs are admitted to its XPU
  };
  /// Before its threads look at anything else.
  void set_up(const On& on) { on_ = on; }
  /// ... before the first job: who is to look when the job that runs is as long as some scenario allows.
  void ask(std::shared_ptr<Alarm> alarm) { alarm_ = std::move(alarm); }
  /// ... before the first init.
  void of_this_thread();
  /// ... behind the last one.
  void before_jobs();

  /// Its jobs are timed.
  [[nodiscard]] bool times(const Placed& placed) const { return holds() || placed.limited; }
  void begin(const Placed& placed, std::uint64_t sequence);
  /// Returns for how long it was without its core; 0 also where nobody counts that.
  [[nodiscard]] std::int64_t end(const Placed& placed);
  /// For how long the job that begins next slept after its hold; of real XPUs that it queues on.
  void overslept(std::int64_t ns) { overslept_ns_ = ns; }
  /// Before it sleeps, where that costs no job anything.
  void tell_cpu_time();

  /// The management thread: the job has lost its XPU, has it back.
  void away(std::int64_t now_ns) { watch_.away(now_ns); }
  void back(std::int64_t now_ns) { watch_.back(now_ns); }

  /// A job that has run past its hang limit, each once. One thread.
  struct Hung {
    const Placed* placed;
    std::uint64_t sequence;
  };
  [[nodiscard]] std::optional<Hung> find_hung(std::int64_t now_ns);
  /// Tells of the job that runs that it is past its WCET, if it is: it may never end. The thread of find_hung.
  void tell_past_wcet(std::int64_t now_ns);
  /// Tells for how long the job that runs has had its XPU, if that is watched; and has who was asked look again
  /// while it runs. Any thread.
  void tell_time(std::int64_t now_ns) const;
  /// Of the execution thread, from `of_this_thread` on. Any thread.
  [[nodiscard]] pid_t thread_id() const { return tid_; }

 private:
  /// The XPU is held by jobs, and no CPU: for how long is counted.
  [[nodiscard]] bool holds() const { return on_.counts != nullptr && !on_.on_thread; }
  struct Without {
    std::int64_t core_ns = 0;     ///< since it began: the kernel ran others there
    std::int64_t foreign_ns = 0;  ///< since the job before: these were none of the run's
  };
  [[nodiscard]] std::int64_t on_core_ns(std::int64_t wall_ns, XNodeLine& line, Without& without);
  std::int64_t tell_waited(std::int64_t without_core_ns, XNodeLine& line);
  [[nodiscard]] std::int64_t so_far_ns(const Stopwatch::Look& seen, std::int64_t now_ns) const;
  [[nodiscard]] std::int64_t own_ns(std::int64_t ran_ns, std::int64_t now_ns) const;
  [[nodiscard]] bool by_levels() const;
  [[nodiscard]] JobsAbove::Begun begun() const { return {level_.load(), before_ns_.load()}; }

  On on_;
  std::shared_ptr<Alarm> alarm_;  ///< null: nobody is asked
  /// By levels, of the job that runs: JobsAbove::Begun.
  std::atomic<int> level_{0};
  std::atomic<std::int64_t> before_ns_{0};
  Stopwatch watch_;                            ///< of the job that runs
  std::atomic<const Placed*> timed_{nullptr};  ///< whose job that is
  std::int64_t overslept_ns_ = 0;
  std::atomic<std::uint64_t> hung_job_{0};  ///< the last one that find_hung found
  /// The last job that was told to be past its WCET while it ran; one more than a job: that one has ended.
  std::atomic<std::uint64_t> past_job_{0};
  std::atomic<std::int64_t> cpu_since_ns_{0};  ///< of the execution thread's CPU time
  /// At the begin of the job that runs; below 0: nobody counts it.
  std::atomic<std::int64_t> without_core_since_ns_{-1};
  std::int64_t cpu_told_ns_ = 0;  ///< ... what is on the board
  /// At the end of the job before: for how long it had waited for its core, and others had run there.
  std::int64_t waited_before_ns_ = 0, others_before_ns_ = 0;
  clockid_t cpu_clock_ = CLOCK_MONOTONIC;  ///< of the execution thread
  pid_t tid_ = 0;                          ///< likewise
};

}  // namespace xauto::runtime

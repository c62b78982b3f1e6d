// SPDX-License-Identifier: Apache-2.0
// Jobs that were started above others on an XPU that preempts by levels, in the board's memory. Nobody is told when
// the hardware takes a job off and lets it go on: a job has had its XPU while none above it was started and not ended.
// That is what its WCET is compared with, and what theorem 13 counts for it (docs/keys.md).
//
// At each instant that belongs to somebody it belongs to the highest that is started. So what those above a job have had
// is the sum of what each level above has had by itself; who starts goes above all that have started, so all of these
// began after it, and how many there were does not matter.
#pragma once

#include <atomic>
#include <cstdint>

namespace xauto {

/// Threads: any, of any process of the run; each level has one job at a time.
class JobsAbove {
 public:
  static constexpr int kLevels =
      64;  ///< so many jobs of an XPU are started at a time (coord/arbiter.h)

  /// A job, as begin() has returned it.
  struct Begun {
    int level = 0;
    std::int64_t before_ns = 0;  ///< what the levels above it had had before
  };
  /// Until end() no more counts of its own time than `longest_ns`, its WCET, since its process may die.
  Begun begin(int level, std::int64_t now_ns, std::int64_t longest_ns);
  void end(const Begun& job, std::int64_t now_ns);
  /// What jobs above it have had since it began.
  [[nodiscard]] std::int64_t above_ns(const Begun& job, std::int64_t now_ns) const {
    return had_above(job.level, now_ns) - job.before_ns;
  }

 private:
  /// Its words belong together while `version` is even.
  struct Level {
    std::atomic<std::uint32_t> version{};
    std::atomic<std::uint32_t> runs{};
    std::atomic<std::int64_t> begin_ns{}, longest_ns{}, before_ns{};  ///< of the job that runs
    std::atomic<std::int64_t> had_ns{};                               ///< those that have ended
  };
  struct Seen {
    bool runs;
    std::int64_t begin_ns, longest_ns, before_ns, had_ns;
    /// Of the one that runs; `above_ns`: what the levels above it have had.
    [[nodiscard]] std::int64_t own_ns(std::int64_t above_ns, std::int64_t now_ns) const;
  };
  [[nodiscard]] static Seen look(const Level& level);
  [[nodiscard]] std::int64_t had_above(int level, std::int64_t now_ns) const;
  Level levels_[kLevels];
  std::atomic<int> high_{};  ///< no job has been on this level or above
};

}  // namespace xauto

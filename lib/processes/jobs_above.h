// SPDX-License-Identifier: Apache-2.0
// Jobs that were started above others on an XPU that preempts by levels, in the board's memory. Nobody is told when
// the hardware takes a job off and lets it go on: a job has had its XPU while none above it was started and not ended.
// That is what its WCET is compared with, and what theorem 13 counts for it (docs/keys.md).
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace xauto {

/// The last ones. Threads: any, of any process of the run.
class JobsAbove {
 public:
  static constexpr std::size_t kKept = 64;

  /// A job begins on `level`, 1 or more. Until end() no more counts of its own time than `longest_ns`, its WCET, since its
  /// process may die; what those above it had meanwhile is not its own. Returns what end() wants.
  std::uint64_t begin(int level, std::int64_t now_ns, std::int64_t longest_ns);
  void end(std::uint64_t job, std::int64_t now_ns);
  /// How much of this time belonged to jobs above `level`; too little where more than kKept have begun since.
  [[nodiscard]] std::int64_t ns(int level, std::int64_t since_ns, std::int64_t until_ns) const;

 private:
  static constexpr std::int64_t kRuns = -1;
  struct Time {
    std::atomic<std::uint64_t> job{};  ///< 0: nobody's, or being written
    std::atomic<std::int32_t> level{};
    std::atomic<std::int64_t> begin_ns{}, longest_ns{}, end_ns{};  ///< end_ns: or kRuns
  };
  std::atomic<std::uint64_t> begun_{};
  Time kept_[kKept];
};

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// When a computation that could go on shall give what it has: at a deadline, or when told.
//
// Whoever takes one asks it at least every few ten milliseconds on the largest app that the file
// format allows, and once it is over, ends with an answer that is weaker but still true.
#pragma once

#include <atomic>
#include <chrono>

namespace xauto::solver {

using TimePoint = std::chrono::steady_clock::time_point;

inline constexpr double kNoLimitS = 1e6;  ///< seconds; from here on a time limit is none

struct Until {
  TimePoint deadline = TimePoint::max();
  const std::atomic<bool>* stop = nullptr;

  [[nodiscard]] bool over() const {
    return (stop != nullptr && stop->load(std::memory_order_relaxed)) ||
           (deadline != TimePoint::max() && std::chrono::steady_clock::now() >= deadline);
  }
};

/// A part of the time that is left, so that others have theirs.
[[nodiscard]] inline Until part_of(const Until& until, double part) {
  Until sooner = until;
  if (until.deadline == TimePoint::max()) return sooner;
  const TimePoint now = std::chrono::steady_clock::now();
  if (now < until.deadline)
    sooner.deadline =
        now + std::chrono::duration_cast<TimePoint::duration>(part * (until.deadline - now));
  return sooner;
}

}  // namespace xauto::solver

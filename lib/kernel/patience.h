// SPDX-License-Identifier: Apache-2.0
// How often a context that does not leave its engine is preempted again. A driver that gives up has
// waited, and held others up; nvgpu even kills a context that was slow for 3 s in its life. So it is
// asked ever later, and in the end never: kmod/queue.c has the same numbers.
#pragma once

#include <algorithm>
#include <cstdint>

namespace xauto::kernel {

/// How often a process tells a driver again what it has suspended: as xauto.ko's sweeper.
inline constexpr int kAgainMs = 50;

/// Value type.
class Patience {
 public:
  static constexpr std::int64_t kSlowNs = 100'000'000;
  static constexpr std::int64_t kFailureNs = 500'000'000;  ///< the least that one counts
  static constexpr std::int64_t kMaxNs = 1'500'000'000;

  /// It has taken so long until it left, or until the driver gave up (`stayed`).
  void waited(std::int64_t begin_ns, std::int64_t end_ns, bool stayed) {
    const std::int64_t took = end_ns - begin_ns;
    if (!stayed && took < kSlowNs) return;
    spent_ns_ += stayed ? std::max(took, kFailureNs) : took;
    if (stayed) again_ns_ = end_ns + 2 * spent_ns_;
  }
  [[nodiscard]] bool may(std::int64_t now_ns) const { return !gated() && now_ns >= again_ns_; }
  [[nodiscard]] bool gated() const { return spent_ns_ >= kMaxNs; }

 private:
  std::int64_t spent_ns_ = 0, again_ns_ = 0;
};

}  // namespace xauto::kernel

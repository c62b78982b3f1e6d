// SPDX-License-Identifier: Apache-2.0
// What an XNode may have of an XPU whose app is not trusted: a sporadic task, whatever the app does. Each of its jobs
// gets a key of the coordinator's, and is off the XPU once it has had it for its budget (docs/keys.md, "Enforcement").
// Pure: no clock, no system call.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <type_traits>

#include "coord/rule.h"

namespace xauto::coord {

/// In ns. All of 1 to kMaxRegulatedNs; budget <= window <= longest.
struct SporadicTask {
  std::uint32_t xnode = 0;
  std::uint32_t pad = 0;
  std::int64_t period_ns = 0;   ///< between the begins of its windows, at least
  std::int64_t window_ns = 0;   ///< from when its job asks to its key
  std::int64_t longest_ns = 0;  ///< it does not start sooner than that before its key
  std::int64_t budget_ns = 0;   ///< for so long a job has the XPU

  [[nodiscard]] bool makes_sense() const;
  bool operator==(const SporadicTask&) const = default;
};
static_assert(std::is_trivially_copyable_v<SporadicTask> && sizeof(SporadicTask) == 40);

inline constexpr std::int64_t kMaxRegulatedNs = 3'600'000'000'000;
/// A thread that is on a core for longer than kRtLimitNs without a pause is ended by the kernel: whoever would take the
/// core from it is gone.
inline constexpr std::int64_t kMaxBudgetNs = 500'000'000, kRtLimitNs = 1'000'000'000;

inline bool SporadicTask::makes_sense() const {
  return period_ns > 0 && period_ns <= kMaxRegulatedNs && budget_ns > 0 && budget_ns <= window_ns &&
         budget_ns <= kMaxBudgetNs && window_ns <= longest_ns && longest_ns <= kMaxRegulatedNs;
}

class Regulator {
 public:
  explicit Regulator(const SporadicTask& task) : task_(task) {}

  struct Window {
    Key key;
    std::int64_t not_before_ns;
  };
  /// A job asks at `now_ns`, CLOCK_MONOTONIC. None: it has asked so often that its turn would come hours later.
  [[nodiscard]] std::optional<Window> ask(std::int64_t now_ns) {
    const std::int64_t begin =
        last_begin_ ? std::max(now_ns, *last_begin_ + task_.period_ns) : now_ns;
    if (begin - now_ns > kMaxRegulatedNs) return std::nullopt;
    last_begin_ = begin;
    const Key key = begin + task_.window_ns;
    return Window{key, key - task_.longest_ns};
  }
  [[nodiscard]] const SporadicTask& task() const { return task_; }
  /// Of the last window; below 0: there was none.
  [[nodiscard]] std::int64_t last_begin_ns() const { return last_begin_.value_or(-1); }

 private:
  SporadicTask task_;
  std::optional<std::int64_t> last_begin_;
};

}  // namespace xauto::coord

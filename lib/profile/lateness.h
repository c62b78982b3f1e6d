// SPDX-License-Identifier: Apache-2.0
// How late a thread wakes that releases sources: what of it is jitter, and what a machine that stood still.
#pragma once

#include <algorithm>
#include <cstdint>

namespace xauto::runtime {

/// Not thread-safe. Times in ns.
class Lateness {
 public:
  /// `shortest_us`: of the periods of what is released. Chosen, not proven: later than half of it is a stall. As jitter it
  /// would be above that period, and in each claim, for what happened once.
  explicit Lateness(std::int64_t shortest_us) : most_ns_(shortest_us * 1000 / 2) {}

  void add(std::int64_t late_ns) {
    ++(late_ns > most_ns_ ? stalls_ : in_time_);
    std::int64_t& latest_ns = late_ns > most_ns_ ? longest_stall_ns_ : latest_ns_;
    latest_ns = std::max(latest_ns, late_ns);
  }

  /// Twice the latest that was no stall.
  [[nodiscard]] std::int64_t jitter_us() const { return 2 * latest_ns_ / 1000 + 1; }
  [[nodiscard]] int stalls() const { return stalls_; }
  [[nodiscard]] int wake_ups() const { return stalls_ + in_time_; }
  [[nodiscard]] std::int64_t longest_stall_ns() const { return longest_stall_ns_; }

 private:
  std::int64_t most_ns_;
  std::int64_t latest_ns_ = 0, longest_stall_ns_ = 0;
  int in_time_ = 0, stalls_ = 0;
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Sets of instants as intervals [begin, end), in ns.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace xauto::import {

using Interval = std::pair<std::int64_t, std::int64_t>;

class Intervals {
 public:
  Intervals() = default;
  /// Their union; they may overlap, and be empty.
  explicit Intervals(std::vector<Interval> all) {
    std::ranges::sort(all);
    for (const Interval& one : all) {
      if (one.first >= one.second) continue;
      if (!parts_.empty() && one.first <= parts_.back().second)
        parts_.back().second = std::max(parts_.back().second, one.second);
      else
        parts_.push_back(one);
    }
    for (const Interval& part : parts_)
      before_.push_back(before_.back() + part.second - part.first);
  }

  [[nodiscard]] const std::vector<Interval>& parts() const { return parts_; }
  [[nodiscard]] std::int64_t length() const { return before_.back(); }
  /// How much of [from, to) is in it. In logarithmic time.
  [[nodiscard]] std::int64_t within(std::int64_t from, std::int64_t to) const {
    return from >= to ? 0 : until(to) - until(from);
  }

 private:
  [[nodiscard]] std::int64_t until(std::int64_t to) const {
    const auto after = std::ranges::upper_bound(parts_, to, {}, &Interval::first);
    const auto n = static_cast<std::size_t>(after - parts_.begin());
    return n == 0 ? 0 : before_[n - 1] + std::min(to, parts_[n - 1].second) - parts_[n - 1].first;
  }

  std::vector<Interval> parts_;             ///< ascending, apart
  std::vector<std::int64_t> before_ = {0};  ///< [n] length of the first n
};

}  // namespace xauto::import

// SPDX-License-Identifier: Apache-2.0
// Quantiles by nearest rank: always a value that was measured, never one between two.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

namespace xauto {

/// No p99 is told of fewer values: it would be the longest.
inline constexpr std::size_t kLeastOfP99 = 100;

/// Which of `count` sorted values is the `q` quantile, counted from 1. There is at least one.
[[nodiscard]] inline std::uint64_t nearest_rank(double q, std::uint64_t count) {
  const double rank = std::ceil(q * static_cast<double>(count));
  return rank < 1 ? 1 : std::min(static_cast<std::uint64_t>(rank), count);
}

/// 0 without values.
[[nodiscard]] inline std::int64_t quantile_of_sorted(std::span<const std::int64_t> sorted,
                                                     double q) {
  return sorted.empty() ? 0 : sorted[nearest_rank(q, sorted.size()) - 1];
}

}  // namespace xauto

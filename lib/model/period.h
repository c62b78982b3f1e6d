// SPDX-License-Identifier: Apache-2.0
// Period: how often a source releases, exactly. 30 Hz is no whole number of microseconds, and 33333
// beside 100000 would repeat after an hour instead of after 100 ms.
#pragma once

#include <compare>
#include <cstdint>

namespace xauto {

/// num / den microseconds, in lowest terms, den >= 1. 30 Hz: 100000 / 3; 30000/1001 Hz: 100100 / 3.
struct Period {
  std::int64_t num = 0;
  std::int64_t den = 1;

  /// Rounded down: for people, and for a timer.
  [[nodiscard]] std::int64_t floor_us() const { return num / den; }
  bool operator==(const Period&) const = default;
};

inline constexpr std::int64_t kMaxPeriodUs = 3'600'000'000;  ///< an hour
inline constexpr std::int64_t kMaxPeriodDen = 1'000'000;

}  // namespace xauto

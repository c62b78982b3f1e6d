// SPDX-License-Identifier: Apache-2.0
// Period: how often a source releases, exactly. 30 Hz is no whole number of microseconds, and 33333
// beside 100000 would repeat after an hour instead of after 100 ms.
#pragma once

#include <compare>
#include <cstdint>
#include <string>
#include <string_view>

#include <xauto/result.h>

namespace xauto {

/// num / den microseconds, in lowest terms, den >= 1. 30 Hz: 100000 / 3; 30000/1001 Hz: 100100 / 3.
struct Period {
  std::int64_t num = 0;
  std::int64_t den = 1;

  /// Of a rate in Hz: "30", "29.97", "30000/1001". Exact, or refused.
  [[nodiscard]] static Result<Period> of_rate(std::string_view hz);
  /// What `of_rate` reads back as the same period.
  [[nodiscard]] std::string rate() const;
  /// Rounded down: for people, and for a timer.
  [[nodiscard]] std::int64_t floor_us() const { return num / den; }
  /// For people: "33333 us", "30 Hz".
  [[nodiscard]] std::string text() const;
  /// In lowest terms, from 1 us to an hour, den at most kMaxPeriodDen.
  [[nodiscard]] bool valid() const;
  bool operator==(const Period&) const = default;
  std::strong_ordering operator<=>(const Period& other) const;  ///< the shorter is less
};

inline constexpr std::int64_t kMaxPeriodUs = 3'600'000'000;  ///< an hour
inline constexpr std::int64_t kMaxPeriodDen = 1'000'000;

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Rate: how often a sensor releases, exactly. 30 Hz is no whole number of microseconds: 33333 us beside
// 100 ms would repeat after an hour, 30 Hz beside 10 Hz repeats after 100 ms.
#pragma once

#include <cstdint>

namespace xauto {

/// `num / den` Hz, from one release per hour to 1 MHz. A value.
struct Rate {
  std::int64_t num = 0;  ///< above 0
  std::int64_t den = 1;  ///< above 0
};

namespace detail {
/// Of "30" or "29.97", whose characters are `C`; num 0: it is no such number of at most 15 digits.
template <char... C>
constexpr Rate rate_of() {
  Rate rate;
  bool fraction = false;
  int digits = 0;
  for (const char c : {C...}) {
    if (c == '\'') continue;
    if (c == '.' && !fraction) {
      fraction = true;
      continue;
    }
    if (c < '0' || c > '9' || ++digits > 15) return {};
    rate.num = rate.num * 10 + (c - '0');
    if (fraction) rate.den *= 10;
  }
  return rate;
}
}  // namespace detail

namespace literals {
/// 30_hz, 29.97_hz: exact.
template <char... C>
constexpr Rate operator""_hz() {
  constexpr Rate rate = detail::rate_of<C...>();
  static_assert(rate.num > 0,
                "a rate above 0 is written as 30_hz or 29.97_hz, of at most 15 digits");
  static_assert(rate.num / 1'000'000 < rate.den || rate.num == 1'000'000 * rate.den,
                "a rate is at most 1 MHz");
  return rate;
}
}  // namespace literals

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Rate: how often a sensor releases, exactly. 30 Hz is no whole number of microseconds: 33333 us beside
// 100 ms would repeat after an hour, 30 Hz beside 10 Hz repeats after 100 ms.
#pragma once

#include <cstdint>

namespace xauto {

/// `num / den` Hz, from one release per hour to 1 MHz. A value.
struct Rate {
  std::int64_t num = 0, den = 1;
};

namespace detail {
/// Of "30" or "29.97": its digits, and how many of them stand behind the point.
consteval Rate rate_of(const char* text) {
  constexpr std::int64_t kMost = 1'000'000'000'000'000;
  Rate rate;
  bool fraction = false;
  for (; *text != '\0'; ++text) {
    if (*text == '\'') continue;
    if (*text == '.' && !fraction) {
      fraction = true;
      continue;
    }
    if (*text < '0' || *text > '9' || rate.num > kMost)
      throw "a rate is written as 30_hz or 29.97_hz";
    rate.num = rate.num * 10 + (*text - '0');
    if (fraction) rate.den *= 10;
  }
  return rate;
}
}  // namespace detail

namespace literals {
/// 30_hz, 29.97_hz: exact. What is no such number does not compile.
consteval Rate operator""_hz(const char* text) {
  return detail::rate_of(text);
}
}  // namespace literals

}  // namespace xauto

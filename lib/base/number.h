// SPDX-License-Identifier: Apache-2.0
// Real numbers and their texts, in the "C" locale whatever the program's is. What <charconv> does; the
// one of GCC 10 has no real numbers.
#pragma once

#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>

namespace xauto {

/// The whole text as a number: no space, no sign but '-'. nullopt: it is none.
[[nodiscard]] std::optional<double> real_of(std::string_view text);
/// The shortest text that reads back as `value`.
[[nodiscard]] std::string text_of(double value);
/// The same without an exponent; empty if it has 64 characters or more.
[[nodiscard]] std::string decimal_of(double value);

/// std::bit_cast, which GCC 10 has not.
[[nodiscard]] inline std::uint64_t bits_of_real(double value) {
  std::uint64_t bits = 0;
  static_assert(sizeof bits == sizeof value);
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}
[[nodiscard]] inline double real_of_bits(std::uint64_t bits) {
  double value = 0;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

}  // namespace xauto

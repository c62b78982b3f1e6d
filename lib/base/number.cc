// SPDX-License-Identifier: Apache-2.0
#include "base/number.h"

#include <charconv>
#include <locale>
#include <sstream>
#include <system_error>

namespace xauto {
namespace {

constexpr std::size_t kDigits = 64;

#ifndef __cpp_lib_to_chars
/// With as few digits behind the point as read back as `value`.
std::string shortest(double value, std::ios_base::fmtflags notation, std::size_t most) {
  for (std::size_t digits = 0; digits <= most; ++digits) {
    std::ostringstream out;
    out.imbue(std::locale::classic());
    out.setf(notation, std::ios_base::floatfield);
    out.precision(static_cast<std::streamsize>(digits));
    out << value;
    if (real_of(out.str()) == value) return out.str();
  }
  return {};
}
#endif

}  // namespace

#ifdef __cpp_lib_to_chars

std::optional<double> real_of(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::string text_of(double value) {
  char digits[kDigits];
  const auto [end, error] = std::to_chars(digits, digits + sizeof digits, value);
  return {digits, error == std::errc() ? end : digits};
}

std::string decimal_of(double value) {
  char digits[kDigits - 1];
  const auto [end, error] =
      std::to_chars(digits, digits + sizeof digits, value, std::chars_format::fixed);
  return {digits, error == std::errc() ? end : digits};
}

#else

std::optional<double> real_of(std::string_view text) {
  if (text.empty() || text.find_first_not_of("0123456789.-eE+") != text.npos || text[0] == '+')
    return std::nullopt;
  std::istringstream in{std::string(text)};
  in.imbue(std::locale::classic());
  double value = 0;
  if (!(in >> value) || in.peek() != std::istringstream::traits_type::eof()) return std::nullopt;
  return value;
}

std::string text_of(double value) {
  const std::string plain = decimal_of(value);
  std::string with_exponent = shortest(value, std::ios_base::scientific, 16);
  return plain.empty() || plain.size() > with_exponent.size() ? with_exponent : plain;
}

std::string decimal_of(double value) {
  std::string text = shortest(value, std::ios_base::fixed, kDigits);
  return text.size() < kDigits ? text : std::string();
}

#endif

}  // namespace xauto

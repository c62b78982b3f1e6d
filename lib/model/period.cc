// SPDX-License-Identifier: Apache-2.0
#include "model/period.h"

#include <numeric>
#include <optional>

namespace xauto {
namespace {

using Wide = __int128;
constexpr std::int64_t kUsPerSecond = 1'000'000;

/// A decimal as a fraction: at most 15 digits, so that nothing overflows.
struct Decimal {
  std::int64_t digits = 0, scale = 1;  // digits / scale
};

std::optional<Decimal> decimal(std::string_view text) {
  Decimal value;
  int digits = 0;
  bool fraction = false;
  for (const char c : text) {
    if (c == '.' && !fraction && digits > 0) {
      fraction = true;
      continue;
    }
    if (c < '0' || c > '9' || ++digits > 15) return std::nullopt;
    value.digits = value.digits * 10 + (c - '0');
    if (fraction) value.scale *= 10;
  }
  if (digits == 0 || text.back() == '.') return std::nullopt;
  return value;
}

Wide gcd(Wide a, Wide b) {
  while (b != 0) {
    const Wide rest = a % b;
    a = b;
    b = rest;
  }
  return a;
}

}  // namespace

std::strong_ordering Period::operator<=>(const Period& other) const {
  const Wide mine = static_cast<Wide>(num) * other.den, its = static_cast<Wide>(other.num) * den;
  return mine < its   ? std::strong_ordering::less
         : mine > its ? std::strong_ordering::greater
                      : std::strong_ordering::equal;
}

bool Period::valid() const {
  return den >= 1 && den <= kMaxPeriodDen && num >= den && num <= kMaxPeriodUs * den &&
         std::gcd(num, den) == 1;
}

Result<Period> Period::of_rate(std::string_view hz) {
  const std::string given = "'" + std::string(hz.substr(0, 40)) + "'";
  const std::size_t slash = hz.find('/');
  const auto above = decimal(hz.substr(0, slash));
  const auto below =
      slash == std::string_view::npos ? Decimal{1, 1} : decimal(hz.substr(slash + 1));
  if (!above || !below || above->digits == 0 || below->digits == 0)
    return fail(ErrorCode::kInvalid, given + " is no rate above 0 of at most 15 digits", {},
                "as in 30, 29.97 or \"30000/1001\"");
  // Up to 15 digits each, and 10^6: below 2^127. Times an hour it would not be.
  Wide num = static_cast<Wide>(below->digits) * above->scale * kUsPerSecond;
  Wide den = static_cast<Wide>(above->digits) * below->scale;
  const Wide common = gcd(num, den);
  num /= common;
  den /= common;
  if (num < den || num / kMaxPeriodUs > den ||
      (num / kMaxPeriodUs == den && num % kMaxPeriodUs > 0))
    return fail(ErrorCode::kInvalid, given + " Hz has no period from 1 us to an hour");
  if (den > kMaxPeriodDen)
    return fail(ErrorCode::kInvalid,
                given + " Hz: in lowest terms, its period in us has a denominator above " +
                    std::to_string(kMaxPeriodDen),
                {}, "round it, or state the period: \"period_us\"");
  return Period{static_cast<std::int64_t>(num), static_cast<std::int64_t>(den)};
}

std::string Period::rate() const {
  const std::int64_t above = kUsPerSecond * den, common = std::gcd(above, num);
  const std::string text = std::to_string(above / common);
  return num == common ? text : text + "/" + std::to_string(num / common);
}

std::string Period::text() const {
  if (den == 1) return std::to_string(num) + " us";
  return valid() ? rate() + " Hz" : std::to_string(num) + "/" + std::to_string(den) + " us";
}

}  // namespace xauto

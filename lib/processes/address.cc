// SPDX-License-Identifier: Apache-2.0
#include "processes/address.h"

#include <charconv>
#include <cstdint>
#include <string_view>

#include "base/utf8.h"

namespace xauto::runtime {

std::optional<RunAddress> parse_address(const std::string& address) {
  const std::string_view prefix = kSocketPrefix;
  const std::size_t first = address.find('/', prefix.size()), last = address.rfind('/');
  if (!address.starts_with(prefix) || first == std::string::npos ||
      for_terminal(address, false) != address)
    return std::nullopt;
  RunAddress parsed{address.substr(prefix.size(), first - prefix.size()), 0,
                    address.substr(last + 1)};
  std::uint32_t number = 0;
  const char* const end = parsed.run.data() + parsed.run.size();
  const auto [dash, wrong] = std::from_chars(parsed.run.data(), end, parsed.pid);
  if (wrong != std::errc() || parsed.pid <= 0 || dash == end || *dash != '-') return std::nullopt;
  const auto [rest, bad] = std::from_chars(dash + 1, end, number);
  if (bad != std::errc() || rest != end) return std::nullopt;
  return parsed;
}

std::string stem_of(const std::string& address) {
  return address.substr(0, address.rfind('/') + 1);
}

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Text from outside, for HTML and XML.
#pragma once

#include <cstdint>
#include <string>

#include <fmt/format.h>

namespace xauto::story {

/// Text for between tags, or for an attribute in quotes of either kind.
[[nodiscard]] inline std::string html_safe(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '&':
        out += "&amp;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

/// "12.34"
[[nodiscard]] inline std::string page_ms(std::int64_t us) {
  return fmt::format("{:.2f}", static_cast<double>(us) / 1000);
}

}  // namespace xauto::story

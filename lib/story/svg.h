// SPDX-License-Identifier: Apache-2.0
// What our pictures share: one look, and text that is text whatever the names are.
#pragma once

#include <string>

#include "story/html.h"

namespace xauto::story {

/// Okabe and Ito's palette for colour-blind readers.
inline constexpr const char* kColours[] = {"#0072B2", "#E69F00", "#009E73", "#CC79A7",
                                           "#56B4E9", "#D55E00", "#8A7A00"};

/// Text for between XML's tags, or for an attribute in double quotes. XML has no way to write most
/// control characters: each becomes U+FFFD.
[[nodiscard]] inline std::string xml_safe(const std::string& text) {
  std::string printable;
  for (const char c : text)
    if (static_cast<unsigned char>(c) < 0x20)
      printable += "\xEF\xBF\xBD";
    else
      printable += c;
  return html_safe(printable);
}

/// At most `most` bytes of it, cut between characters, as xml_safe().
[[nodiscard]] inline std::string clipped(const std::string& name, std::size_t most) {
  if (name.size() <= most) return xml_safe(name);
  std::size_t cut = most - 1;
  while (cut > 0 && (static_cast<unsigned char>(name[cut]) & 0xC0U) == 0x80U) --cut;
  return xml_safe(name.substr(0, cut)) + "…";
}

}  // namespace xauto::story

// SPDX-License-Identifier: Apache-2.0
// An XML file as a tree of elements, read by Expat.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <xauto/result.h>

namespace xauto::import {

/// Names are as they are written, with their prefixes; texts between elements are left out.
struct Xml {
  std::string name;
  std::vector<std::pair<std::string, std::string>> attributes;
  std::vector<Xml> children;

  /// Empty: it has none.
  [[nodiscard]] const std::string& operator[](std::string_view attribute) const;
  [[nodiscard]] const Xml* child(std::string_view name) const;  ///< the first; null: there is none
};

inline constexpr int kMaxXmlDepth = 64;
inline constexpr std::size_t kMaxXmlBytes = 256u << 20, kMaxXmlElements = 4'000'000,
                             kMaxXmlAttributes = 64;

/// The root. Errors: no XML; too deep, too much; a DOCTYPE, so no entity of the file's own is ever read; Expat was not
/// there when this program was built.
[[nodiscard]] Result<Xml> parse_xml(std::string_view text, const std::string& origin);

}  // namespace xauto::import

// SPDX-License-Identifier: Apache-2.0
// A YAML file as a tree, read by libyaml.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

namespace xauto::import {

/// A text, a list, or a map whose keys are texts. What is not there is an empty text.
struct Yaml {
  std::string text;
  std::vector<Yaml> list;
  std::vector<std::string> keys;  ///< of a map, as many as values
  std::vector<Yaml> values;

  [[nodiscard]] const Yaml& operator[](std::string_view key) const;
};

inline constexpr int kMaxYamlDepth = 32;
inline constexpr std::size_t kMaxYamlNodes = 1'000'000;

/// The first document. Errors: no YAML; too deep, too much; an alias, or a key that is no text; libyaml was not there when
/// this program was built.
[[nodiscard]] Result<Yaml> parse_yaml(std::string_view text, const std::string& origin);

}  // namespace xauto::import

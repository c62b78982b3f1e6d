// SPDX-License-Identifier: Apache-2.0
#include "import/yaml.h"

namespace xauto::import {

const Yaml& Yaml::operator[](std::string_view key) const {
  static const Yaml none;
  for (const auto& [name, value] : map)
    if (name == key) return value;
  return none;
}

}  // namespace xauto::import

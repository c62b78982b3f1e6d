// SPDX-License-Identifier: Apache-2.0
#include "import/yaml.h"

namespace xauto::import {

const Yaml& Yaml::operator[](std::string_view key) const {
  static const Yaml none;
  for (std::size_t k = 0; k < keys.size(); ++k)
    if (keys[k] == key) return values[k];
  return none;
}

}  // namespace xauto::import

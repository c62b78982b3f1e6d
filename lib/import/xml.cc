// SPDX-License-Identifier: Apache-2.0
#include "import/xml.h"

#include <algorithm>

namespace xauto::import {

const std::string& Xml::operator[](std::string_view attribute) const {
  static const std::string none;
  for (const auto& [key, value] : attributes)
    if (key == attribute) return value;
  return none;
}

const Xml* Xml::child(std::string_view wanted) const {
  const auto found = std::ranges::find(children, wanted, &Xml::name);
  return found == children.end() ? nullptr : &*found;
}

}  // namespace xauto::import

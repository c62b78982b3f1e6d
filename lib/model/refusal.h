// SPDX-License-Identifier: Apache-2.0
// Private to lib/model: how its validators refuse.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <unordered_set>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

inline std::string quoted(const std::string& name) {
  return "'" + name + "'";
}

inline tl::unexpected<Error> invalid(std::string what, std::string where, std::string hint = {}) {
  return fail(ErrorCode::kInvalid, std::move(what), std::move(where), std::move(hint));
}

inline std::string nth(const char* list, std::size_t i) {
  return "/" + std::string(list) + "/" + std::to_string(i);
}

/// Names of a list are there, short and different.
template <class Named>
[[nodiscard]] Status validate_names(const std::vector<Named>& list, const char* key,
                                    const char* what) {
  std::unordered_set<std::string_view> names;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const std::string& name = list[i].name;
    const std::string where = nth(key, i) + "/name";
    if (name.empty()) return invalid(std::string("a ") + what + " needs a name", where);
    if (name.size() > kMaxNameBytes)
      return invalid("a name is longer than " + std::to_string(kMaxNameBytes) + " bytes", where);
    if (!names.insert(name).second)
      return invalid(std::string("two ") + what + "s are called " + quoted(name), where);
  }
  return {};
}

inline Status in_range(std::int64_t value, std::int64_t low, std::int64_t high, const char* what,
                       const std::string& where) {
  if (value >= low && value <= high) return {};
  return invalid(std::to_string(value) + " is not " + what + " from " + std::to_string(low) +
                     " to " + std::to_string(high),
                 where);
}

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Private to lib/model: how its validators refuse.
#pragma once

#include <string>
#include <utility>

#include <xauto/result.h>

namespace xauto {

inline std::string quoted(const std::string& name) {
  return "'" + name + "'";
}

inline tl::unexpected<Error> invalid(std::string what, std::string where, std::string hint = {}) {
  return fail(ErrorCode::kInvalid, std::move(what), std::move(where), std::move(hint));
}

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace xauto::test {

/// The least app.json, with `rest` behind its last key.
inline std::string app_text(const std::string& rest) {
  return R"({"schema":"xauto.app","version":3,"name":"a","sources":[{"name":"s"}],)"
         R"("xnodes":[{"name":"x","module":"M","source":"s","wcet_us":{"cpu":1}}],"edges":[])" +
         rest + "}";
}

}  // namespace xauto::test

// SPDX-License-Identifier: Apache-2.0
// Where libyaml-dev was not installed when this was built.
#include "import/yaml.h"

namespace xauto::import {

Result<Yaml> parse_yaml(std::string_view text, const std::string& origin) {
  (void)text;
  return fail(ErrorCode::kUnavailable, "this xauto was built without libyaml", origin,
              "build it where libyaml-dev is installed");
}

}  // namespace xauto::import

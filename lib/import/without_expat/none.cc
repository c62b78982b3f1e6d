// SPDX-License-Identifier: Apache-2.0
#include "import/xml.h"

namespace xauto::import {

Result<Xml> parse_xml(std::string_view, const std::string& origin) {
  return fail(ErrorCode::kUnavailable, "this program was built without Expat", origin,
              "install libexpat1-dev and build it again");
}

}  // namespace xauto::import

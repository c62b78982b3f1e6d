// SPDX-License-Identifier: Apache-2.0
// Where libbabeltrace2-dev was not installed when this was built.
#include "import/ctf.h"

namespace xauto::import {

Result<Trace> read_ctf(const std::string& folder, const std::vector<const char*>& providers,
                       const std::vector<WantedEvent>& wanted) {
  (void)providers, (void)wanted;
  return fail(ErrorCode::kUnavailable, "this xauto was built without libbabeltrace2", folder,
              "build it where libbabeltrace2-dev is installed");
}

}  // namespace xauto::import

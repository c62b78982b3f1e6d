// SPDX-License-Identifier: Apache-2.0
// policy.json from outside, for an app and a platform of our own: those of tests/golden.
#include "model/json.h"

#include "golden.h"
#include "json_property.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  static const Platform platform = fuzz::golden_platform();
  static const AppSpec app = fuzz::golden_app();
  const auto read = [](std::string_view text) {
    return parse_policy(text, fuzz::kOrigin, app, platform);
  };
  fuzz::check_read(
      read({reinterpret_cast<const char*>(data), size}),
      [](const Policy& policy) { return to_json(policy, app, platform); }, read);
  return 0;
}

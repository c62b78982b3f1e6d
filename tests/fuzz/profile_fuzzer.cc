// SPDX-License-Identifier: Apache-2.0
// profile.json from outside.
#include "model/json.h"

#include "json_property.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const auto read = [](std::string_view text) { return parse_profile(text, fuzz::kOrigin); };
  fuzz::check_read(
      read({reinterpret_cast<const char*>(data), size}),
      [](const Profile& value) { return to_json(value); }, read);
  return 0;
}

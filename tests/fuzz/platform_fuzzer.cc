// SPDX-License-Identifier: Apache-2.0
// platform.json from outside.
#include "model/json.h"

#include "json_property.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const auto read = [](std::string_view text) { return parse_platform(text, fuzz::kOrigin); };
  fuzz::check_read(
      read({reinterpret_cast<const char*>(data), size}),
      [](const Platform& value) { return to_json(value); }, read);
  return 0;
}

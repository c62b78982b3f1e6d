// SPDX-License-Identifier: Apache-2.0
// app.json from outside.
#include <cstdlib>

#include "model/contention.h"
#include "model/json.h"

#include "json_property.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const auto read = [](std::string_view text) { return parse_app(text, fuzz::kOrigin); };
  fuzz::check_read(
      read({reinterpret_cast<const char*>(data), size}),
      [](const AppSpec& value) { return to_json(value); }, read);
  // Whatever is accepted has a time beside whatever it may meet.
  static const Platform platform = Platform::builtin("large").value();
  const auto app = read({reinterpret_cast<const char*>(data), size});
  if (!app || !validate_on(*app, platform)) return 0;
  for (const XNodeSpec& x : app->xnodes)
    for (const auto& [type, alone] : x.wcet_us) {
      const auto beside = wcet_beside(x, type, {});
      if (!beside || *beside != alone || longest_wcet(x, type) < alone) std::abort();
    }
  return 0;
}

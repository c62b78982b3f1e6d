// SPDX-License-Identifier: Apache-2.0
// scenarios.json, tables.json, emulation.json and demand.json from outside, for an app and a platform of our own: those of
// tests/golden, and something that the app can do without.
#include "model/json.h"

#include "golden.h"
#include "json_property.h"

namespace {

xauto::AppSpec make_app() {
  xauto::AppSpec app = xauto::fuzz::golden_app();
  app.xnodes[1].variants = {{"small", 60, {{"gpu", 2000}, {"cpu", 9000}}}};
  app.modules[1].optional = true;
  return app;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  static const Platform platform = fuzz::golden_platform();
  static const AppSpec app = make_app();
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto tables = [](std::string_view from) {
    return parse_tables(from, fuzz::kOrigin, app, platform);
  };
  fuzz::check_read(
      tables(text), [](const Tables& t) { return to_json(t, app, platform); }, tables);
  const auto scenarios = [](std::string_view from) {
    return parse_scenarios(from, fuzz::kOrigin, app, platform);
  };
  fuzz::check_read(
      scenarios(text), [](const Scenarios& s) { return to_json(s); }, scenarios);
  const auto script = [](std::string_view from) {
    return parse_emulation_script(from, fuzz::kOrigin, platform);
  };
  fuzz::check_read(
      script(text), [](const EmulationScript& s) { return to_json(s); }, script);
  const auto demand = [](std::string_view from) { return parse_demand(from, fuzz::kOrigin); };
  fuzz::check_read(
      demand(text), [](const Demand& d) { return to_json(d); }, demand);
  return 0;
}

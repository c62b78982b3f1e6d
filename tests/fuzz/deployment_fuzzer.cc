// SPDX-License-Identifier: Apache-2.0
// deployment.json from outside, for an app of our own. What was accepted can be asked for any
// module.
#include "model/deployment.h"

#include "json_property.h"

namespace {

xauto::AppSpec make_app() {
  using xauto::AppSpec;
  AppSpec app;
  app.name = "driving";
  app.xnodes = {{"fcd.pre", "FCD", {{"cpu", 3000}}},
                {"fcd.infer", "FCD", {{"gpu", 7000}}},
                {"spur/größe", "LA~/", {{"cpu", 2500}}}};
  app.edges = {{0, 1}};
  return app;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  static const AppSpec app = make_app();
  const auto read = [](std::string_view text) {
    return parse_deployment(text, fuzz::kOrigin, app);
  };
  const auto value = read({reinterpret_cast<const char*>(data), size});
  fuzz::check_read(
      value, [](const Deployment& deployment) { return to_json(deployment); }, read);
  if (!value) return 0;
  std::size_t modules = 0;
  for (const auto& process : value->processes(app)) modules += process.size();
  fuzz::require(modules <= 2, "every module is in one process at most");
  for (const char* module : {"FCD", "LA~/"}) {
    const ModuleDeployment m = value->of(module);
    fuzz::require(!m.process || !m.isolate, "process excludes isolate");
    fuzz::require(!m.hang_pct || !m.hang_us, "hang_pct excludes hang_us");
    fuzz::require(!m.on_hang || m.hang_pct || m.hang_us, "an action needs a limit");
  }
  return 0;
}

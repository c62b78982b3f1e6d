// SPDX-License-Identifier: Apache-2.0
// xauto graph: an app as a picture; with a policy, where each XNode runs.
#include <iostream>
#include <memory>

#include "model/json.h"
#include "model/json_value.h"
#include "story/app_graph.h"

#include "xauto/command.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

struct GraphFlags {
  std::string app, platform, policy, dot, svg;
};

Result<int> graph(const GraphFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--dot", flags.dot));
  XAUTO_TRY(outputs.expect("--svg", flags.svg));
  Platform platform;
  story::GraphPlaces places;
  if (!flags.policy.empty()) {
    XAUTO_ASSIGN(platform, load_platform_of(flags.policy, flags.platform));
    XAUTO_ASSIGN(const Policy policy, load_policy(flags.policy, app, platform));
    places.platform = &platform;
    for (const Placement& p : policy.placements) places.xpu.push_back(p.xpu);
    places.crossings = policy.crossings;
  }
  const std::string dot = graph_dot(app, places);
  if (options.json)
    std::cout << Json{{"app", app.name}, {"dot", dot}}.dump(2) << "\n";
  else if (flags.dot.empty() && flags.svg.empty())
    std::cout << dot;
  outputs.write(flags.dot, dot);
  if (!flags.svg.empty()) outputs.write(flags.svg, graph_svg(app, places));
  return outputs.status(kDone);
}

}  // namespace

void add_graph(Commands& commands) {
  auto flags = std::make_shared<GraphFlags>();
  Verb verb = commands.add(
      "graph",
      "Draw an app: sources and their rates, XModules, XNodes, who fires and samples whom.",
      "xauto graph --app app.json --policy policy.json --svg app.svg",
      [flags](const Options& options) { return graph(*flags, options); });
  verb.option("--app", flags->app, "app.json").required();
  verb.option("--policy", flags->policy, "policy.json: draws where each XNode runs, too");
  verb.option("--platform", flags->platform, kPlatformNames).shown_as("the policy's");
  verb.option("--dot", flags->dot,
              "write it here for Graphviz; without --dot and --svg: to stdout");
  verb.option("--svg", flags->svg, "write it here as an SVG that any browser opens");
}

}  // namespace xauto::cli

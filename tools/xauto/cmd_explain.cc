// SPDX-License-Identifier: Apache-2.0
// xauto explain: which chain sets the latency of a policy, and which XPU limits it.
#include <cstdio>
#include <iostream>
#include <memory>

#include <nlohmann/json.hpp>

#include "model/json.h"
#include "solver/explain.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

struct Flags {
  std::string app, platform, policy;
};

double in_ms(std::int64_t us) {
  return static_cast<double>(us) / 1000;
}

Result<int> explain(const Flags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  XAUTO_ASSIGN(const Policy policy, load_policy(flags.policy, app, platform));
  XAUTO_ASSIGN(const solver::Explanation why, solver::explain(app, platform, policy));
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  const auto xpu = [&](int i) {
    return platform
        .xpus[static_cast<std::size_t>(policy.placements[static_cast<std::size_t>(i)].xpu)]
        .id;
  };
  if (options.json) {
    nlohmann::json chain = nlohmann::json::array();
    for (const solver::Link& link : why.chain) {
      nlohmann::json behind = nlohmann::json::array();
      for (int j : link.behind) behind.push_back(name(j));
      chain.push_back({{"xnode", name(link.xnode)},
                       {"xpu", xpu(link.xnode)},
                       {"ready_us", link.ready_us},
                       {"start_us", link.start_us},
                       {"finish_us", link.finish_us},
                       {"wcet_us", link.wcet_us},
                       {"behind", behind}});
    }
    std::cout << nlohmann::json{{"sentence", why.sentence},
                                {"limiting_xpu",
                                 platform.xpus[static_cast<std::size_t>(why.limiting_xpu)].id},
                                {"limiting_us", why.limiting_us},
                                {"running_us", why.running_us},
                                {"critical_path_us", why.critical_path_us},
                                {"chain", chain}}
                     .dump(2)
              << "\n";
    return kDone;
  }
  std::printf("%s\n\n  %-24s %-8s %10s %10s %10s   behind\n", why.sentence.c_str(), "XNode", "XPU",
              "ready ms", "runs ms", "finish ms");
  for (const solver::Link& link : why.chain) {
    std::string behind;
    for (int j : link.behind) behind += (behind.empty() ? "" : ", ") + name(j);
    std::printf("  %-24s %-8s %10.2f %10.2f %10.2f   %s\n", name(link.xnode).c_str(),
                xpu(link.xnode).c_str(), in_ms(link.ready_us), in_ms(link.wcet_us),
                in_ms(link.finish_us), behind.c_str());
  }
  std::printf("\n  On any number of XPUs the app would still take %.2f ms (its critical path).\n",
              in_ms(why.critical_path_us));
  return kDone;
}

}  // namespace

void add_explain(Commands& commands) {
  auto flags = std::make_shared<Flags>();
  CLI::App* verb =
      commands.add("explain", "Name the chain that sets the latency and the XPU that limits it.",
                   "xauto explain --app app.json --platform small --policy policy.json",
                   [flags](const Options& options) {
                     const auto status = explain(*flags, options);
                     return status ? *status : report(status.error());
                   });
  verb->add_option("--app", flags->app, "app.json")->required();
  verb->add_option("--platform", flags->platform, "small, large, or a platform.json")->required();
  verb->add_option("--policy", flags->policy, "policy.json")->required();
}

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// xauto simulate: what a policy does, to the microsecond, without running anything.
#include <algorithm>
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "model/json.h"
#include "model/json_value.h"
#include "solver/simulate.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/periodic.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct SimulateFlags {
  std::string app, platform = "small", policy, model = "xauto", out;
  solver::steady::PlayOptions play;
};

Result<int> simulate(const SimulateFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_any_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (app.version == 2) {
    if (flags.model != "xauto" || flags.policy.empty())
      return fail(ErrorCode::kInvalid, "an app of version 2 is simulated with a policy of keys",
                  "--policy");
    return simulate_periodic(app, platform, flags.policy, flags.play, flags.out, options);
  }
  const auto scheduling = *runtime::scheduling_from(flags.model);
  std::optional<Policy> policy;
  if (scheduling != runtime::Scheduling::kRos2) {
    if (flags.policy.empty())
      return fail(ErrorCode::kInvalid, "is needed unless --model ros2", "--policy");
    XAUTO_ASSIGN(policy, load_policy(flags.policy, app, platform));
  }
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_ASSIGN(const solver::Simulation s, predict(app, platform, scheduling, policy));

  std::vector<std::size_t> order(app.xnodes.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(s.start[a], a) < std::pair(s.start[b], b);
  });
  Json xnodes = Json::array();
  std::string table =
      fmt::format("  {:<24}{:<8}{:>12}{:>12}\n", "XNode", "XPU", "start us", "finish us");
  for (const std::size_t i : order) {
    const std::string& xpu = platform.xpus[static_cast<std::size_t>(s.xpu[i])].id;
    xnodes.push_back({{"name", app.xnodes[i].name},
                      {"xpu", xpu},
                      {"start_us", s.start[i]},
                      {"finish_us", s.finish[i]}});
    table += fmt::format("  {:<24}{:<8}{:>12}{:>12}\n", app.xnodes[i].name, xpu, s.start[i],
                         s.finish[i]);
  }
  const Json document = {{"schema", "xauto.simulation"},
                         {"version", 1},
                         {"app", app.name},
                         {"platform", platform.name},
                         {"model", flags.model},
                         {"latency_us", s.makespan},
                         {"preemptions", s.preemptions},
                         {"xnodes", std::move(xnodes)}};
  const std::string result = document.dump(2) + "\n";
  if (options.json)
    std::cout << result;
  else
    std::cout << table
              << fmt::format("\n  {} on {}, {}: latency {:.3f} ms, {} preemptions\n", app.name,
                             platform.name, flags.model, static_cast<double>(s.makespan) / 1000,
                             s.preemptions);
  outputs.write(flags.out, result);
  return outputs.status(kDone);
}

}  // namespace

void add_simulate(Commands& commands) {
  auto flags = std::make_shared<SimulateFlags>();
  Verb verb = commands.add("simulate", "Simulate a policy, or the ROS 2 model, to the microsecond.",
                           "xauto simulate --app app.json --platform small --policy policy.json",
                           [flags](const Options& options) { return simulate(*flags, options); });
  verb.option("--app", flags->app, "app.json").required();
  verb.option("--platform", flags->platform, kPlatformNames).shown();
  verb.option("--policy", flags->policy, "policy.json");
  verb.option(
          "--model", flags->model,
          "xauto: the policy; timeshare: its assignment, nobody schedules; ros2: each stage on its "
          "fastest XPU, nobody schedules")
      .one_of({"xauto", "timeshare", "ros2"})
      .shown();
  verb.option("--out", flags->out, "write the result here");
  verb.option("--seconds", flags->play.seconds, "version 2: how long").range(1, 86400).shown();
  verb.flag("--random-times", flags->play.random_times,
            "version 2: execution times up to the WCET");
  verb.flag("--jitter", flags->play.jitter,
            "version 2: each source as late as it may be, at random");
  verb.flag("--phases", flags->play.phases,
            "version 2: between clocks at random, and clocks drift: constantly, at the ends of "
            "their ppm, bending");
  verb.flag("--urgent", flags->play.urgent,
            "version 2: releases that may be urgent are, or are not, at random");
  verb.option("--seed", flags->play.seed, "version 2: of all that is random").shown();
}

}  // namespace xauto::cli

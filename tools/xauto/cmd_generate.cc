// SPDX-License-Identifier: Apache-2.0
// xauto generate: an app of the paper's synthetic workload, with every choice that its text leaves
// open.
#include <algorithm>
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "model/json.h"
#include "model/json_value.h"
#include "solver/generate.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

struct GenerateFlags {
  solver::GenerateOptions options;
  std::vector<int> branches = {2, 6};
  std::vector<std::int64_t> cpu_us = {5'000, 95'000};
  std::vector<double> gpu_speedup = {3, 8}, dla_speedup = {2, 5};
  std::string out;
};

Result<int> generate(const GenerateFlags& flags, const Options& options) {
  solver::GenerateOptions o = flags.options;
  o.branch_min = flags.branches[0];
  o.branch_max = flags.branches[1];
  o.cpu_min_us = flags.cpu_us[0];
  o.cpu_max_us = flags.cpu_us[1];
  o.gpu_speedup_min = flags.gpu_speedup[0];
  o.gpu_speedup_max = flags.gpu_speedup[1];
  o.dla_speedup_min = flags.dla_speedup[0];
  o.dla_speedup_max = flags.dla_speedup[1];
  XAUTO_ASSIGN(const AppSpec app, solver::generate(o));
  if (!flags.out.empty()) XAUTO_TRY(write_file(flags.out, to_json(app)));

  std::int64_t work = 0;
  for (const XNodeSpec& x : app.xnodes) {
    std::int64_t least = x.wcet_us.begin()->second;
    for (const auto& [type, us] : x.wcet_us) least = std::min(least, us);
    work += least;
  }
  if (options.json) {
    Json described;
    for (const auto& [name, value] : o.describe()) described[name] = value;
    Json result = {
        {"app", app.name},           {"hash", app.hash()},    {"xnodes", app.xnodes.size()},
        {"edges", app.edges.size()}, {"least_work_us", work}, {"options", std::move(described)}};
    if (!flags.out.empty()) result["out"] = flags.out;
    if (flags.out.empty()) result["file"] = Json::parse(to_json(app)).value_or(Json());
    std::cout << result.dump(2) << "\n";
    return kDone;
  }
  if (flags.out.empty()) {
    std::cout << to_json(app);
    return kDone;
  }
  std::cout << fmt::format("{}: {} XNodes, {} edges, hash {}\n\n", app.name, app.xnodes.size(),
                           app.edges.size(), app.hash());
  for (const auto& [name, value] : o.describe())
    std::cout << fmt::format("  {:<18} {}\n", name, value);
  std::cout << fmt::format(
      "\n  written to {0}\n\nNext, e.g. on the emulated platform `small`:\n"
      "  xauto solve --app {0} --platform small --out policy.json\n"
      "  xauto run --app {0} --policy policy.json --emulate --activations 20 -- xauto-standin "
      "{0}\n",
      flags.out);
  return kDone;
}

}  // namespace

void add_generate(Commands& commands) {
  auto flags = std::make_shared<GenerateFlags>();
  Verb verb = commands.add("generate", "Make an app of the paper's synthetic workload.",
                           "xauto generate --nodes 40 --seed 7 --out app.json",
                           [flags](const Options& options) { return generate(*flags, options); });
  solver::GenerateOptions& o = flags->options;
  verb.option("--nodes", o.nodes, "XNodes, exactly").shown();
  verb.option("--seed", o.seed, "same seed, same app").shown();
  verb.option("--out", flags->out, "where app.json goes; stdout if not given");
  verb.option("--terminal", o.terminal, "probability that a node is not expanded").shown();
  verb.option("--max-depth", o.max_depth, "nesting of parallel sub-graphs; 0: 4, more where needed")
      .shown();
  verb.option("--branches", flags->branches, "least and most branches of a sub-graph")
      .values(2)
      .shown();
  verb.flag("!--no-fork-join", o.fork_join, "branches without an XNode at their fork and join");
  verb.option("--sibling-edge", o.sibling_edge, "probability of an edge between two branches")
      .shown();
  verb.option("--sibling-direction", o.sibling_direction, "forward, shuffled or node").shown();
  verb.duration("--cpu-time", flags->cpu_us, Unit::kMicroseconds, 1, 1e9, "least and most CPU time")
      .values(2);
  verb.option("--heavy-share", o.heavy_share, "XNodes that count as heavy").shown();
  verb.option("--heavy-gpu", o.heavy_gpu, "probability of a GPU implementation, heavy").shown();
  verb.option("--heavy-dla", o.heavy_dla, "of a DLA implementation, heavy").shown();
  verb.option("--light-gpu", o.light_gpu, "of a GPU implementation, light").shown();
  verb.option("--light-dla", o.light_dla, "of a DLA implementation, light").shown();
  verb.option("--gpu-speedup", flags->gpu_speedup, "over the CPU").values(2).shown();
  verb.option("--dla-speedup", flags->dla_speedup, "over the CPU").values(2).shown();
  verb.option("--cpu-share", o.cpu_share, "XNodes that keep a CPU implementation beside another")
      .shown();
}

}  // namespace xauto::cli

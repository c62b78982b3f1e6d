// SPDX-License-Identifier: Apache-2.0
#include "solver/verify_tables.h"

#include "base/index.h"
#include "solver/verify_world.h"

namespace xauto::solver {

TablesVerification verify_tables(const AppSpec& app, const Platform& platform, const Tables& tables,
                                 const VerifyOptions& options) {
  TablesVerification all;
  if (const Status valid = validate(tables, app, platform); !valid) {
    all.lies.push_back(valid.error().to_string());
    return all;
  }
  all.worst_regret = tables.worst_regret();
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    const Scenario& scenario = tables.scenarios[s];
    const Served& served = tables.serves[s];
    const AppSpec scaled = app_under(app, scenario);
    const Platform left = platform_under(platform, scenario);
    // A policy of the scenario's app, with the claims of the file and the times that it has here.
    Policy policy = policy_under(tables.tables[at(served.table)], app, platform, scenario);
    const verification::World world(scaled, left);
    verification::Candidate candidate;
    candidate.order_before.resize(scaled.xnodes.size());
    std::vector<verification::Us> takes;
    for (std::size_t i = 0; i < policy.placements.size(); ++i) {
      candidate.xpu.push_back(policy.placements[i].xpu);
      candidate.priority.push_back(policy.placements[i].priority);
      takes.push_back(*world.wcet[i][at(policy.placements[i].xpu)]);
    }
    for (const auto& [u, v] : policy.order) candidate.order_before[at(v)].push_back(u);
    const verification::Execution executed = verification::execute(world, candidate, takes);
    for (std::size_t i = 0; i < policy.placements.size(); ++i) {
      policy.placements[i].start_us = executed.start[i];
      policy.placements[i].finish_us = executed.finish[i];
    }
    policy.latency_us = executed.latency;
    policy.lower_bound_us = served.lower_bound_us;
    policy.worst_case_us = served.worst_case_us;
    const Verification v = verify(scaled, left, policy, options);
    const auto tell = [&](const std::vector<std::string>& from, std::vector<std::string>& to) {
      for (const std::string& line : from) {
        // Times and latency are of this very execution: nothing of the file is shown by them.
        const bool ours = line.starts_with("start and finish") || line.starts_with("latency_us");
        if (!ours) to.push_back("scenario '" + scenario.name + "': " + line);
      }
    };
    tell(v.lies, all.lies);
    tell(v.shown, all.shown);
    tell(v.taken, all.taken);
    if (!v.counterexample.empty())
      all.lies.push_back("scenario '" + scenario.name + "': " + v.counterexample);
  }
  return all;
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
#include "solver/verify_tables.h"

#include <algorithm>

#include "base/index.h"
#include "solver/keys/check.h"
#include "solver/keys/check_handover.h"
#include "solver/verify_world.h"

namespace xauto::solver {

namespace {

/// A table as a policy of the scenario's app, with the times that it has there.
PriorityPlan executed_under(const Table& table, const AppSpec& app, const Platform& platform,
                            const Scenario& scenario) {
  PriorityPlan policy = policy_under(table, app, platform, scenario);
  const verification::World world(app_under(app, scenario, table.loss),
                                  platform_under(platform, scenario));
  verification::Candidate candidate;
  candidate.order_before.resize(policy.placements.size());
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
  return policy;
}

void verify_changes(const AppSpec& app, const Platform& platform, const Tables& tables,
                    const VerifyOptions& options, TablesVerification& all) {
  // There may be thousands: each is executed and certified, and attacked a little.
  VerifyOptions quick = options;
  quick.executions = std::min<std::int64_t>(options.executions, 100);
  quick.proof_nodes = quick.schedules = 0;
  std::size_t certified = 0, without = 0;
  for (const Change& change : tables.changes) {
    const Scenario both =
        across(app, tables.scenarios[at(change.from)], tables.scenarios[at(change.to)]);
    const std::string name = "change from '" + tables.scenarios[at(change.from)].name + "' to '" +
                             tables.scenarios[at(change.to)].name + "': ";
    const Table& table = tables.tables[at(tables.serves[at(change.from)].table)];
    const PriorityPlan placed = policy_under(table, app, platform, both);
    const bool lost = std::any_of(placed.placements.begin(), placed.placements.end(),
                                  [](const PriorityPlacement& p) { return p.xpu < 0; });
    if (!change.worst_case_us) {
      ++without;
      continue;
    }
    if (lost) {
      all.lies.push_back(name + "a worst case, though its table needs an XPU that is lost");
      continue;
    }
    PriorityPlan policy = executed_under(table, app, platform, both);
    policy.worst_case_us = change.worst_case_us;
    const Verification v =
        verify(app_under(app, both, table.loss), platform_under(platform, both), policy, quick);
    for (const std::string& lie : v.lies) all.lies.push_back(name + lie);
    const bool shown = std::any_of(v.shown.begin(), v.shown.end(), [](const std::string& line) {
      return line.starts_with("worst_case_us");
    });
    if (shown)
      ++certified;
    else if (v.lies.empty())
      all.taken.push_back(name + "its worst case was not re-derived");
  }
  if (certified > 0)
    all.shown.push_back("the worst case of a release that spans a change, of " +
                        std::to_string(certified) + " changes" +
                        (without > 0 ? "; " + std::to_string(without) + " have none" : ""));
}

/// Each table of keys at its envelope, which is what its claims are about.
void verify_keys(const AppSpec& app, const Platform& platform, const Tables& tables,
                 TablesVerification& all) {
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Scenario envelope = xauto::envelope(tables, t, app);
    const std::string name = "table '" + tables.tables[t].name + "': ";
    const Loss& loss = tables.tables[t].loss;
    const auto report = keys::examine(app_under(app, envelope, loss),
                                      platform_with(platform_under(platform, envelope), loss.off),
                                      keys_under(tables, t, app, platform, envelope));
    if (!report)
      all.lies.push_back(name + report.error().to_string());
    else if (report->lies.empty())
      all.shown.push_back(name +
                          "every job ends by its key and every chain within its worst case, " +
                          "at the longest WCETs of all that it serves");
    else
      for (const Error& lie : report->lies) all.lies.push_back(name + lie.to_string());
  }
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s)
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      if (tables.serves[s].chain_bound_us[c] >
          tables.keys[at(tables.serves[s].table)].chains[c].worst_case_us)
        all.lies.push_back("scenario '" + tables.scenarios[s].name + "': chain '" +
                           app.chains[c].name + "' has a worst case below its lower bound");
  all.taken.emplace_back("the lower bounds of the scenarios");
}

/// Keys of a table with a claim for every chain of the app, since derive_handover looks at all of them.
/// Where the table has none, no claim of a change is held against that one (validate).
Policy keys_of_all(const Tables& tables, std::size_t table, const AppSpec& app,
                   const Platform& platform) {
  Policy keys = tables.keys[table];
  keys.app = app.name;
  const std::vector<int> xpus = xpus_on(platform, tables.tables[table], app);
  for (std::size_t i = 0; i < xpus.size(); ++i) keys.placements[i].xpu = xpus[i];
  for (ChainClaim& claim : keys.chains)
    claim.worst_case_us = std::max<std::int64_t>(claim.worst_case_us, 0);
  return keys;
}

void verify_handovers(const AppSpec& app, const Platform& platform, const Tables& tables,
                      TablesVerification& all) {
  const Platform whole = platform_of_all(tables, platform);
  const auto left = [&](const Scenario& scenario, std::size_t table) {
    return app_of_all_chains(app_under(app, scenario), tables.tables[table].loss);
  };
  std::vector<AppSpec> under;
  std::vector<Scenario> envelopes;
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    envelopes.push_back(envelope(tables, t, app));
    under.push_back(left(envelopes.back(), t));
  }
  std::size_t shown = 0, without = 0;
  for (const Handover& claim : tables.handovers) {
    const std::string name = "from '" + tables.tables[at(claim.from)].name + "' to '" +
                             tables.tables[at(claim.to)].name + "': ";
    const bool claims = std::any_of(claim.worst_case_us.begin(), claim.worst_case_us.end(),
                                    [](const auto& us) { return us.has_value(); });
    const bool lost = needs_lost(tables.tables[at(claim.from)], platform, envelopes[at(claim.to)]);
    if (lost && claims)
      all.lies.push_back(name + "a worst case, though it may need an XPU that is lost");
    if (!claims || lost) {
      without += app.chains.size();
      continue;
    }
    const AppSpec both =
        left(across(app, envelopes[at(claim.from)], envelopes[at(claim.to)]), at(claim.from));
    Policy from = keys_of_all(tables, at(claim.from), app, whole),
           to = keys_of_all(tables, at(claim.to), app, whole);
    from.app_hash = under[at(claim.from)].hash();
    to.app_hash = under[at(claim.to)].hash();
    const auto proof = keys::derive_handover(
        {under[at(claim.from)], under[at(claim.to)], both, whole, from, to, tables.notice_us});
    if (!proof) {
      all.lies.push_back(name + proof.error().to_string());
      continue;
    }
    std::int64_t settles_us = 0;  // of what is claimed
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (!claim.worst_case_us[c]) {
        ++without;
        continue;
      }
      settles_us = std::max(settles_us, proof->chain_settles_us[c]);
      const auto& derived = proof->worst_case_us[c];
      if (derived && *claim.worst_case_us[c] == kNotThere) continue;  // it has settled
      if (!derived)
        all.lies.push_back(name + "chain '" + app.chains[c].name +
                           "' has a worst case, and none follows" +
                           (proof->why_not.empty() ? "" : ": " + proof->why_not.front()));
      else if (*derived > *claim.worst_case_us[c])
        all.lies.push_back(name + "chain '" + app.chains[c].name + "' is said to take " +
                           std::to_string(*claim.worst_case_us[c]) + " us at most; " +
                           std::to_string(*derived) + " follow");
      else
        ++shown;
    }
    if (claim.settles_us < settles_us)
      all.lies.push_back(name + "settles_us is said to be " + std::to_string(claim.settles_us) +
                         "; " + std::to_string(settles_us) + " follow");
  }
  if (shown > 0)
    all.shown.push_back("the worst case of " + std::to_string(shown) +
                        " chains while one table takes the place of another" +
                        (without > 0 ? "; " + std::to_string(without) + " have none" : ""));
}

}  // namespace

TablesVerification verify_tables(const AppSpec& app, const Platform& platform, const Tables& tables,
                                 const VerifyOptions& options) {
  TablesVerification all;
  if (const Status valid = validate(tables, app, platform); !valid) {
    all.lies.push_back(valid.error().to_string());
    return all;
  }
  all.worst_regret = tables.worst_regret();
  if (!tables.keys.empty()) {
    verify_keys(app, platform, tables, all);
    verify_handovers(app, platform, tables, all);
    return all;
  }
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    const Scenario& scenario = tables.scenarios[s];
    const Served& served = tables.serves[s];
    const Table& table = tables.tables[at(served.table)];
    const AppSpec left_app = app_under(app, scenario, table.loss);
    const Platform left = platform_under(platform, scenario);
    PriorityPlan policy = executed_under(table, app, platform, scenario);
    policy.lower_bound_us = served.lower_bound_us;
    policy.worst_case_us = served.worst_case_us;
    const Verification v = verify(left_app, left, policy, options);
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
  verify_changes(app, platform, tables, options, all);
  return all;
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/check_tables.h"

#include <algorithm>
#include <numeric>
#include <optional>
#include <utility>

#include "base/index.h"
#include "solver/keys/check.h"
#include "solver/keys/check_handover.h"

namespace xauto::solver::keys {

namespace {

/// The keys that the sequence of `policy` has at this app's WCETs: on each XPU one job after the other, by their old keys.
/// What runs by the old ones runs by these, of one release at a time, since on each XPU they compare alike. nullopt: two
/// of one XPU have the same.
std::optional<Policy> in_sequence(const AppSpec& app, const Platform& platform, Policy policy) {
  std::vector<std::size_t> turn(app.xnodes.size());
  std::iota(turn.begin(), turn.end(), 0);
  std::vector<std::int64_t> key;
  for (const Placement& placed : policy.placements) key.push_back(placed.key_us.front());
  std::ranges::sort(turn, {}, [&](std::size_t i) { return key[i]; });
  const std::vector<std::int64_t> transfer = transfers_us(policy, app, platform);
  std::vector<std::vector<std::pair<std::size_t, std::int64_t>>> waits(turn.size());
  for (std::size_t e = 0; e < app.edges.size(); ++e)
    waits[at(app.edges[e].second)].emplace_back(at(app.edges[e].first), transfer[e]);
  for (const auto& [u, v] : policy.order) waits[at(v)].emplace_back(at(u), 0);
  std::vector<std::int64_t> end(turn.size(), 0), last_key(platform.xpus.size(), -1),
      last_end(platform.xpus.size(), 0);
  for (const std::size_t i : turn) {
    Placement& placed = policy.placements[i];
    const std::size_t x = at(placed.xpu);
    const auto wcet = app.xnodes[i].wcet_on(platform.xpus[x].type);
    if (!wcet || std::exchange(last_key[x], key[i]) == key[i]) return std::nullopt;
    std::int64_t start = last_end[x];
    for (const auto& [u, us] : waits[i]) start = std::max(start, end[u] + us);
    for (const std::int64_t hold : placed.hold_us) start = std::max(start, hold);
    end[i] = last_end[x] = start + *wcet;
    placed.key_us = {end[i]};
  }
  return policy;
}

/// [chain of app_with()] of a release of an app that releases one at a time within `scenario`'s WCETs, by the sequence of
/// a table; nullopt: nothing follows.
std::optional<std::vector<std::int64_t>> in_sequence(const AppSpec& app, const Platform& platform,
                                                     const Tables& tables, std::size_t table,
                                                     const Scenario& scenario) {
  const Loss& loss = tables.tables[table].loss;
  const AppSpec left = app_under(app, scenario, loss);
  const Platform on = platform_with(platform_under(platform, scenario), loss.off);
  const Policy keys = keys_under(tables, table, app, platform, scenario);
  if (std::ranges::any_of(keys.placements, [](const Placement& p) { return p.xpu < 0; }))
    return std::nullopt;
  const std::optional<Policy> policy = in_sequence(left, on, keys);
  if (!policy) return std::nullopt;
  const auto report = examine(left, on, *policy);
  // Its claims are those of the envelope, which the XPUs do not depend on.
  if (!report || report->chains.size() != left.chains.size()) return std::nullopt;
  std::vector<std::int64_t> derived;
  for (const ChainProof& chain : report->chains) derived.push_back(chain.derived_us);
  return derived;
}

/// Each table at its envelope.
void check_keys(const AppSpec& app, const Platform& platform, const Tables& tables,
                TablesReport& all) {
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Scenario envelope = xauto::envelope(tables, t, app);
    const std::string name = "table '" + tables.tables[t].name + "': ";
    const Loss& loss = tables.tables[t].loss;
    const auto report = examine(app_under(app, envelope, loss),
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
}

/// What a scenario claims beyond its table, and that no bound is above its worst case.
void check_scenarios(const AppSpec& app, const Platform& platform, const Tables& tables,
                     TablesReport& all) {
  std::size_t shown = 0;
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    const Served& served = tables.serves[s];
    const Table& table = tables.tables[at(served.table)];
    const std::string name = "scenario '" + tables.scenarios[s].name + "': ";
    if (served.lower_bound_us > served.worst_case_us)
      all.lies.push_back(name + "lower_bound_us is " + std::to_string(served.lower_bound_us) +
                         ", above the worst case");
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      if (served.chain_bound_us[c] > served.chain_worst_us[c])
        all.lies.push_back(name + "chain '" + app.chains[c].name +
                           "' has a worst case below its lower bound");
    const std::vector<int> there = kept_chains(app, table.loss);
    const auto less = [&](int c) {
      return served.chain_worst_us[at(c)] < table.keys.chains[at(c)].worst_case_us;
    };
    if (std::ranges::none_of(there, less)) continue;
    const auto derived = in_sequence(app, platform, tables, at(served.table), tables.scenarios[s]);
    for (std::size_t k = 0; k < there.size(); ++k) {
      if (!less(there[k])) continue;
      const std::int64_t claim = served.chain_worst_us[at(there[k])];
      const std::string what = name + "chain '" + app.chains[at(there[k])].name +
                               "' is said to take " + std::to_string(claim) + " us at most";
      if (!derived)
        all.lies.push_back(what + "; nothing less follows than what its table claims");
      else if ((*derived)[k] > claim)
        all.lies.push_back(what + "; " + std::to_string((*derived)[k]) + " follow");
      else
        ++shown;
    }
  }
  if (shown > 0)
    all.shown.push_back("the worst case of " + std::to_string(shown) +
                        " chains at the WCETs of their scenario alone");
  all.taken.emplace_back("the lower bounds of the scenarios");
  for (const Xpu& xpu : platform.xpus)
    if (std::string cost = unmeasured(xpu); !cost.empty()) all.taken.push_back(std::move(cost));
}

/// Keys of a table with a claim for every chain of the app, since derive_handover looks at all of them.
/// Where the table has none, no claim of a change is held against that one (validate).
Policy keys_of_all(const Tables& tables, std::size_t table, const AppSpec& app,
                   const Platform& platform) {
  Policy keys = tables.tables[table].keys;
  keys.app = app.name;
  const std::vector<int> xpus = xpus_on(platform, tables.tables[table], app);
  for (std::size_t i = 0; i < xpus.size(); ++i) keys.placements[i].xpu = xpus[i];
  for (ChainClaim& claim : keys.chains)
    claim.worst_case_us = std::max<std::int64_t>(claim.worst_case_us, 0);
  return keys;
}

/// Of an app that releases one at a time: it keeps its table, and all is over when the next one comes.
HandoverProof release_that_meets(const AppSpec& app, const Platform& platform, const Tables& tables,
                                 std::size_t from, const Scenario& spans) {
  HandoverProof proof;
  proof.worst_case_us.resize(app.chains.size());
  proof.chain_settles_us.assign(app.chains.size(), 0);
  const std::vector<int> there = kept_chains(app, tables.tables[from].loss);
  const auto derived = in_sequence(app, platform, tables, from, spans);
  if (!derived) return proof;
  proof.worst_case_us.assign(app.chains.size(), 0);  // of what it does not have all is over, too
  for (std::size_t k = 0; k < there.size(); ++k) proof.worst_case_us[at(there[k])] = (*derived)[k];
  return proof;
}

void check_handovers(const AppSpec& app, const Platform& platform, const Tables& tables,
                     TablesReport& all) {
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
    HandoverProof proof;
    const Scenario spans = across(app, envelopes[at(claim.from)], envelopes[at(claim.to)]);
    if (app.one_at_a_time) {
      proof = release_that_meets(app, platform, tables, at(claim.from), spans);
    } else {
      const AppSpec both = left(spans, at(claim.from));
      Policy from = keys_of_all(tables, at(claim.from), app, whole),
             to = keys_of_all(tables, at(claim.to), app, whole);
      from.app_hash = under[at(claim.from)].hash();
      to.app_hash = under[at(claim.to)].hash();
      Result<HandoverProof> derived = derive_handover(
          {under[at(claim.from)], under[at(claim.to)], both, whole, from, to, tables.notice_us});
      if (!derived) {
        all.lies.push_back(name + derived.error().to_string());
        continue;
      }
      proof = std::move(*derived);
    }
    std::int64_t settles_us = 0;  // of what is claimed
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (!claim.worst_case_us[c]) {
        ++without;
        continue;
      }
      settles_us = std::max(settles_us, proof.chain_settles_us[c]);
      const auto& derived = proof.worst_case_us[c];
      if (derived && *claim.worst_case_us[c] == kNotThere) continue;  // it has settled
      if (!derived)
        all.lies.push_back(name + "chain '" + app.chains[c].name +
                           "' has a worst case, and none follows" +
                           (proof.why_not.empty() ? "" : ": " + proof.why_not.front()));
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

TablesReport examine_tables(const AppSpec& app, const Platform& platform, const Tables& tables) {
  TablesReport all;
  if (const Status valid = validate(tables, app, platform); !valid) {
    all.lies.push_back(valid.error().to_string());
    return all;
  }
  all.worst_regret = tables.worst_regret();
  check_keys(app, platform, tables, all);
  check_scenarios(app, platform, tables, all);
  check_handovers(app, platform, tables, all);
  return all;
}

}  // namespace xauto::solver::keys

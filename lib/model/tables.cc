// SPDX-License-Identifier: Apache-2.0
#include "model/tables.h"

#include <algorithm>
#include <array>
#include <set>
#include <tuple>
#include <utility>

#include "base/index.h"

namespace xauto {
namespace {

/// They are none, or all from one table to another, in that order.
Status validate_pairs(const Tables& tables) {
  const std::size_t n = tables.tables.size();
  if (!tables.handovers.empty() && tables.handovers.size() != n * (n - 1))
    return fail(ErrorCode::kInvalid, "are not all from one table to another, each once",
                "/handovers");
  for (std::size_t k = 0; k < tables.handovers.size(); ++k) {
    const std::size_t from = k / (n - 1), rest = k % (n - 1), to = rest + (rest >= from ? 1 : 0);
    const Handover& of = tables.handovers[k];
    if (of.from != static_cast<int>(from) || of.to != static_cast<int>(to))
      return fail(ErrorCode::kInvalid,
                  "is not that from '" + tables.tables[from].name + "' to '" +
                      tables.tables[to].name + "', which comes here",
                  "/handovers/" + std::to_string(k));
  }
  return {};
}

}  // namespace

const char* to_string(Why why) {
  constexpr std::array<const char*, 7> kNames = {"start", "asked",   "machine", "overrun",
                                                 "back",  "outside", "lost"};
  const auto at = static_cast<std::size_t>(why);
  return at < kNames.size() ? kNames[at] : "?";
}

double Tables::worst_regret() const {
  double worst = 0;
  for (const Served& s : serves)
    worst = std::max(worst, static_cast<double>(s.worst_case_us) /
                                static_cast<double>(std::max<std::int64_t>(1, s.lower_bound_us)));
  return worst;
}

AppSpec app_under(const AppSpec& app, const Scenario& scenario, const Loss& loss) {
  return app_with(app_under(app, scenario), loss);
}

Scenario envelope(const Tables& tables, std::size_t table, const AppSpec& app) {
  std::optional<Scenario> all;
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    if (tables.serves[s].table != static_cast<int>(table)) continue;
    all = all ? across(app, *all, tables.scenarios[s]) : tables.scenarios[s];
  }
  return all.value_or(Scenario{});
}

Policy keys_under(const Tables& tables, std::size_t table, const AppSpec& app,
                  const Platform& platform, const Scenario& scenario) {
  Policy policy = tables.tables[table].keys;
  const Loss& loss = tables.tables[table].loss;
  const Platform left = platform_with(platform_under(platform, scenario), loss.off);
  policy.app = app.name;
  policy.app_hash = app_under(app, scenario, loss).hash();
  policy.platform = left.name;
  policy.method = "tables";
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    int& xpu = policy.placements[i].xpu;
    xpu = left.find(xpu < 0 ? off_xpu(app.xnodes[i].module) : platform.xpus[at(xpu)].id);
  }
  std::erase_if(policy.chains,
                [](const ChainClaim& claim) { return claim.worst_case_us == kNotThere; });
  return policy;
}

Platform platform_of_all(const Tables& tables, const Platform& platform) {
  std::set<std::string> off;
  for (const Table& table : tables.tables) off.insert(table.loss.off.begin(), table.loss.off.end());
  return platform_with(platform, {off.begin(), off.end()});
}

std::vector<int> xpus_on(const Platform& platform_of_all, const Table& table, const AppSpec& app) {
  std::vector<int> xpus;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    xpus.push_back(table.xpu(i) >= 0 ? table.xpu(i)
                                     : platform_of_all.find(off_xpu(app.xnodes[i].module)));
  return xpus;
}

namespace {

/// What a chain's time is measured in; nullopt: others have a deadline, and it has none.
std::optional<std::int64_t> unit_us(const AppSpec& app, std::size_t chain) {
  return app.has_deadlines() ? app.chains[chain].deadline_us : 1;
}

}  // namespace

Objective chain_objective(const AppSpec& app, const std::vector<std::int64_t>& us) {
  Objective largest, sum;
  for (std::size_t k = 0; k < app.chains.size(); ++k) {
    if (us[k] == kNotThere) continue;
    sum.value += static_cast<double>(us[k]);
    const auto unit = unit_us(app, k);
    if (!unit) continue;
    const double value = static_cast<double>(us[k]) / static_cast<double>(*unit);
    if (largest.chain < 0 || value > largest.value) largest = {value, static_cast<int>(k)};
  }
  const bool sums = !app.has_deadlines() && !app.one_at_a_time;
  return sums || largest.chain < 0 ? sum : largest;
}

std::int64_t objective_us(const AppSpec& app, double value, int chain) {
  constexpr double kRounding = 1e-6;
  const auto unit = chain < 0 ? 1 : unit_us(app, at(chain)).value_or(1);
  return static_cast<std::int64_t>(value * static_cast<double>(unit) + kRounding);
}

std::int64_t bound_of_chains(const Served& served, const AppSpec& app) {
  return objective_us(app, chain_objective(app, served.chain_bound_us).value,
                      chain_objective(app, served.chain_worst_us).chain);
}

void set_figures(Tables& tables, const AppSpec& app) {
  for (Served& served : tables.serves) {
    const Objective of = chain_objective(app, served.chain_worst_us);
    served.worst_case_us = objective_us(app, of.value, of.chain);
    served.lower_bound_us = std::max(served.lower_bound_us, bound_of_chains(served, app));
  }
}

const Handover* handover_of(const Tables& tables, int from, int to) {
  if (tables.handovers.empty() || from == to) return nullptr;
  const std::size_t n = tables.tables.size();
  return &tables.handovers[(n - 1) * at(from) + at(to) - (to > from ? 1 : 0)];
}

bool needs_lost(const Table& table, const Platform& platform, const Scenario& scenario) {
  const Platform left = platform_under(platform, scenario);
  return std::ranges::any_of(table.keys.placements, [&](const Placement& p) {
    return p.xpu >= 0 && left.find(platform.xpus[at(p.xpu)].id) < 0;
  });
}

bool both_have(const Tables& tables, int from, int to, std::size_t chain) {
  return tables.tables[at(from)].keys.chains[chain].worst_case_us != kNotThere &&
         tables.tables[at(to)].keys.chains[chain].worst_case_us != kNotThere;
}

bool Handover::claims_all() const {
  return std::all_of(worst_case_us.begin(), worst_case_us.end(),
                     [](const auto& us) { return us.has_value(); });
}

std::vector<char> chains_of(const Policy& keys) {
  std::vector<char> there;
  for (const ChainClaim& claim : keys.chains)
    there.push_back(claim.worst_case_us == kNotThere ? 0 : 1);
  return there;
}

std::vector<std::int64_t> largest_claims(const Tables& tables) {
  std::vector<std::int64_t> largest;
  for (const Table& table : tables.tables) {
    largest.resize(table.keys.chains.size());
    for (std::size_t c = 0; c < largest.size(); ++c)
      largest[c] = std::max(largest[c], table.keys.chains[c].worst_case_us);
  }
  for (const Handover& change : tables.handovers)
    for (std::size_t c = 0; c < largest.size(); ++c)
      largest[c] = std::max(largest[c], change.worst_case_us[c].value_or(0));
  return largest;
}

PriorityPlan whole_policy(const Tables& tables, std::size_t table, const AppSpec& app,
                          const Platform& platform) {
  Policy whole = tables.tables[table].keys;
  const Table& first = tables.tables[at(tables.serves.front().table)];
  for (std::size_t i = 0; i < whole.placements.size(); ++i)
    if (whole.placements[i].xpu < 0) whole.placements[i].xpu = first.xpu(i);
  std::erase_if(whole.order, [&](const std::pair<int, int>& pair) {
    return tables.tables[table].xpu(at(pair.first)) < 0;
  });
  whole.app = app.name;
  whole.app_hash = app.hash();
  whole.platform = platform.name;
  whole.method = "tables";
  return assignment_of(whole);
}

namespace {

/// XNode, variant, XPU.
std::set<std::tuple<std::size_t, int, int>> made_by(const Tables& tables) {
  std::set<std::tuple<std::size_t, int, int>> made;
  for (const Table& table : tables.tables)
    for (std::size_t i = 0; i < table.keys.placements.size(); ++i)
      if (table.xpu(i) >= 0) made.emplace(i, table.loss.variant_of(i), table.xpu(i));
  return made;
}

}  // namespace

std::size_t instances(const Tables& tables) {
  return made_by(tables).size();
}

InstanceMemory memory_of_instances(const Tables& tables, const AppSpec& app,
                                   const Platform& platform) {
  InstanceMemory memory;
  for (const auto& [i, variant, xpu] : made_by(tables)) {
    const XNodeSpec& x = app.xnodes[i];
    const auto& kb =
        variant < 0 ? x.memory_kb : x.variants[static_cast<std::size_t>(variant)].memory_kb;
    const auto at = kb.find(platform.xpus[static_cast<std::size_t>(xpu)].type);
    if (at == kb.end()) continue;
    memory.kb += at->second;
    ++memory.measured;
  }
  return memory;
}

std::size_t moves(const Table& a, const Table& b) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.keys.placements.size(); ++i)
    if (a.xpu(i) >= 0 && b.xpu(i) >= 0 &&
        (a.xpu(i) != b.xpu(i) || a.loss.variant_of(i) != b.loss.variant_of(i)))
      ++count;
  return count;
}

namespace {

/// Every XNode that is not off has a place.
Status validate(const Table& table, const AppSpec& app, const std::string& where) {
  if (table.keys.placements.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid, "does not place every XNode", where + "/xnodes");
  XAUTO_TRY(validate(table.loss, app, where));
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const bool off = table.loss.is_off(app.xnodes[i].module);
    if (off == (table.xpu(i) < 0)) continue;
    return fail(ErrorCode::kInvalid,
                "XNode '" + app.xnodes[i].name + "' is " +
                    (off ? "placed, and its module is off" : "not placed"),
                where + "/xnodes");
  }
  return {};
}

/// [chain] a time where `there` has the chain, kNotThere elsewhere.
bool are_of_chains(const std::vector<std::int64_t>& us, const std::vector<char>& there) {
  if (us.size() != there.size()) return false;
  for (std::size_t c = 0; c < us.size(); ++c)
    if (there[c] != 0 ? us[c] < 0 || us[c] > kMaxTimeUs : us[c] != kNotThere) return false;
  return true;
}

/// Keys and claims of each table, at its envelope.
Status validate_keys(const Tables& tables, const AppSpec& app, const Platform& platform) {
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Scenario all = envelope(tables, t, app);
    const Loss& loss = tables.tables[t].loss;
    if (!tables.tables[t].keys.order.empty() && !app.one_at_a_time)
      return fail(ErrorCode::kInvalid,
                  "is of an app whose sources have rates: what a change costs is not known with it",
                  "/tables/" + std::to_string(t) + "/order");
    std::vector<char> there(app.chains.size(), 0);
    for (const int c : kept_chains(app, loss)) there[at(c)] = 1;
    if (!are_of_chains(worst_cases(tables.tables[t].keys), there))
      return fail(ErrorCode::kInvalid,
                  "has no worst case for each chain without a module that is off, and for these "
                  "alone",
                  "/tables/" + std::to_string(t));
    if (Status valid =
            validate(keys_under(tables, t, app, platform, all), app_under(app, all, loss),
                     platform_with(platform_under(platform, all), loss.off));
        !valid) {
      Error error = std::move(valid).error();
      error.where = "/tables/" + std::to_string(t) + error.where;
      return tl::unexpected<Error>(std::move(error));
    }
  }
  return {};
}

/// What is claimed of scenarios, and of changes.
Status validate_claims(const Tables& tables, const AppSpec& app) {
  const auto is_time = [](std::int64_t us) { return us >= 0 && us <= kMaxTimeUs; };
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const std::string place = "/serves/" + std::to_string(s);
    const Served& served = tables.serves[s];
    const Policy& keys = tables.tables[at(served.table)].keys;
    const std::vector<char> there = chains_of(keys);
    if (!are_of_chains(served.chain_bound_us, there) ||
        !are_of_chains(served.chain_worst_us, there))
      return fail(ErrorCode::kInvalid,
                  "has no worst case and lower bound for each chain of its table, or one too many",
                  place + "/chains");
    if (!is_time(served.lower_bound_us))
      return fail(ErrorCode::kInvalid, "is out of range", place + "/lower_bound_us");
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      const std::int64_t own = served.chain_worst_us[c], all = keys.chains[c].worst_case_us;
      if (own > all || (own < all && !app.one_at_a_time))
        return fail(ErrorCode::kInvalid,
                    "chain '" + app.chains[c].name + "' takes " + std::to_string(own) +
                        " us there, and " + std::to_string(all) + " in all that its table serves" +
                        (own > all ? "" : ": by keys at a rate it is the same"),
                    place + "/chains");
    }
  }
  if (!is_time(tables.notice_us)) return fail(ErrorCode::kInvalid, "is out of range", "/notice_us");
  XAUTO_TRY(validate_pairs(tables));
  for (std::size_t k = 0; k < tables.handovers.size(); ++k) {
    const Handover& h = tables.handovers[k];
    if (h.worst_case_us.size() != app.chains.size() || !is_time(h.settles_us) ||
        !std::all_of(h.worst_case_us.begin(), h.worst_case_us.end(),
                     [&](const auto& us) { return !us || is_time(*us) || *us == kNotThere; }))
      return fail(ErrorCode::kInvalid, "has a chain too few or too many, or a time out of range",
                  "/handovers/" + std::to_string(k) + "/chains");
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      if (h.worst_case_us[c] &&
          (*h.worst_case_us[c] == kNotThere) == both_have(tables, h.from, h.to, c))
        return fail(
            ErrorCode::kInvalid,
            "chain '" + app.chains[c].name +
                "' has a worst case where a table does not have the chain, or \"off\" where "
                "both have it",
            "/handovers/" + std::to_string(k) + "/chains");
  }
  return {};
}

}  // namespace

Status validate(const Tables& tables, const AppSpec& app, const Platform& platform) {
  if (tables.app != app.name)
    return fail(ErrorCode::kInvalid,
                "are for app '" + tables.app + "', this is app '" + app.name + "'", "/app");
  if (tables.app_hash != app.hash())
    return fail(ErrorCode::kInvalid, "are for another version of app '" + app.name + "'",
                "/app_hash", "solve again");
  XAUTO_TRY(validate(Scenarios{tables.app, tables.scenarios}, app, platform));
  if (tables.tables.empty() || tables.tables.size() > kMaxTables)
    return fail(ErrorCode::kInvalid,
                std::to_string(tables.tables.size()) + " tables; 1 to " +
                    std::to_string(kMaxTables) + " are possible",
                "/tables");
  std::set<std::string> names;
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Table& table = tables.tables[t];
    const std::string at = "/tables/" + std::to_string(t);
    if (table.name.empty()) return fail(ErrorCode::kInvalid, "a table needs a name", at + "/name");
    if (!names.insert(table.name).second)
      return fail(ErrorCode::kInvalid, "two tables are called '" + table.name + "'", at + "/name");
    XAUTO_TRY(validate(table, app, at));
  }
  if (tables.serves.size() != tables.scenarios.size())
    return fail(ErrorCode::kInvalid, "does not serve every scenario", "/serves");
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const Served& served = tables.serves[s];
    const std::string at = "/serves/" + std::to_string(s);
    const Scenario& scenario = tables.scenarios[s];
    if (served.table < 0 || static_cast<std::size_t>(served.table) >= tables.tables.size())
      return fail(ErrorCode::kInvalid, "there is no such table", at + "/table");
    const Table& table = tables.tables[static_cast<std::size_t>(served.table)];
    if (!table.loss.none() && !scenario.degraded)
      return fail(ErrorCode::kInvalid,
                  "table '" + table.name + "' loses something (" + words_of(table.loss, app) +
                      "), and scenario '" + scenario.name + "' is not degraded",
                  at + "/table");
    if (needs_lost(table, platform, scenario))
      return fail(ErrorCode::kInvalid,
                  "table '" + table.name + "' has an XNode on an XPU that scenario '" +
                      scenario.name + "' has lost",
                  at + "/table");
  }
  XAUTO_TRY(validate_keys(tables, app, platform));
  return validate_claims(tables, app);
}

}  // namespace xauto

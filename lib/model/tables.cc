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

/// All (from, to) of `n`, each once and from != to, in this order.
std::pair<int, int> pair_at(std::size_t k, std::size_t n) {
  const std::size_t from = k / (n - 1), to = k % (n - 1);
  return {static_cast<int>(from), static_cast<int>(to + (to >= from ? 1 : 0))};
}
template <class Pair>
const Pair* find_pair(const std::vector<Pair>& pairs, std::size_t n, int from, int to) {
  if (pairs.empty() || from == to) return nullptr;
  return &pairs[(n - 1) * at(from) + at(to) - (to > from ? 1 : 0)];
}

/// `pairs` are none, or all of `named`, in that order. `what`: one of them, `all`: all of them.
template <class Pair, class Named>
Status validate_pairs(const std::vector<Pair>& pairs, const std::vector<Named>& named,
                      const std::string& place, const char* all, const char* what) {
  const std::size_t n = named.size();
  if (!pairs.empty() && pairs.size() != n * (n - 1)) return fail(ErrorCode::kInvalid, all, place);
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto [from, to] = pair_at(k, n);
    if (pairs[k].from != from || pairs[k].to != to)
      return fail(ErrorCode::kInvalid,
                  std::string("is not ") + what + " from '" + named[at(from)].name + "' to '" +
                      named[at(to)].name + "', which comes here",
                  place + "/" + std::to_string(k));
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

std::optional<std::int64_t> time_for_a_release(const AppSpec& app) {
  std::optional<std::int64_t> least_us = app.deadline_us;
  for (const ChainSpec& chain : app.chains)
    if (chain.deadline_us) least_us = std::min(least_us.value_or(kMaxTimeUs), *chain.deadline_us);
  return least_us;
}

Status may_have_priorities(const AppSpec& app) {
  const char* hint = "give every source a rate: tables have keys then, which know of it";
  for (const TransferSpec& transfer : app.transfers)
    if (transfer.transfer_us > 0)
      return fail(ErrorCode::kInvalid,
                  "a message takes " + std::to_string(transfer.transfer_us) +
                      " us from one XPU to another, and tables of priorities know of no transfers",
                  app.name + "/edges", hint);
  const auto differs = [&](const ChainSpec& chain) {
    return chain.deadline_us != app.chains.front().deadline_us;
  };
  if (const auto other = std::find_if(app.chains.begin(), app.chains.end(), differs);
      other != app.chains.end())
    return fail(ErrorCode::kInvalid,
                "chains '" + app.chains.front().name + "' and '" + other->name +
                    "' have different deadlines, and tables of priorities know one, of a whole "
                    "release",
                app.name + "/chains", hint);
  return {};
}

AppSpec app_under(const AppSpec& app, const Scenario& scenario, const Loss& loss) {
  return app_with(app_under(app, scenario), loss);
}

PriorityPlan policy_under(const Table& table, const AppSpec& app, const Platform& platform,
                          const Scenario& scenario) {
  const AppSpec left_app = app_under(app, scenario, table.loss);
  const Platform left = platform_under(platform, scenario);
  PriorityPlan policy;
  policy.app = left_app.name;
  policy.app_hash = left_app.hash();
  policy.platform = left.name;
  policy.method = "tables";
  std::vector<int> now(table.xpu.size(), -1);
  for (const int i : kept(app, table.loss)) {
    now[at(i)] = static_cast<int>(policy.placements.size());
    const std::string& id = platform.xpus[at(table.xpu[at(i)])].id;
    policy.placements.push_back({left.find(id), table.priority[at(i)], 0, 0});
  }
  for (const auto& [u, v] : table.order) policy.order.emplace_back(now[at(u)], now[at(v)]);
  return policy;
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
  Policy policy = tables.keys[table];
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
  std::vector<int> xpus = table.xpu;
  for (std::size_t i = 0; i < xpus.size(); ++i)
    if (xpus[i] < 0) xpus[i] = platform_of_all.find(off_xpu(app.xnodes[i].module));
  return xpus;
}

Objective chain_objective(const AppSpec& app, const std::vector<std::int64_t>& us) {
  Objective objective;
  for (std::size_t k = 0; k < app.chains.size(); ++k) {
    if (us[k] == kNotThere) continue;
    objective.sum_us += us[k];
    if (!app.chains[k].deadline_us) continue;
    const double late =
        static_cast<double>(us[k]) / static_cast<double>(*app.chains[k].deadline_us);
    if (objective.chain >= 0 && late <= objective.late) continue;
    objective.late = late;
    objective.chain = static_cast<int>(k);
  }
  return objective;
}

const Change* change_of(const Tables& tables, int from, int to) {
  return find_pair(tables.changes, tables.scenarios.size(), from, to);
}

const Handover* handover_of(const Tables& tables, int from, int to) {
  return find_pair(tables.handovers, tables.tables.size(), from, to);
}

bool needs_lost(const Table& table, const Platform& platform, const Scenario& scenario) {
  const Platform left = platform_under(platform, scenario);
  return std::any_of(table.xpu.begin(), table.xpu.end(),
                     [&](int x) { return x >= 0 && left.find(platform.xpus[at(x)].id) < 0; });
}

bool both_have(const Tables& tables, int from, int to, std::size_t chain) {
  return tables.keys[at(from)].chains[chain].worst_case_us != kNotThere &&
         tables.keys[at(to)].chains[chain].worst_case_us != kNotThere;
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
  for (const Policy& keys : tables.keys) {
    largest.resize(keys.chains.size());
    for (std::size_t c = 0; c < largest.size(); ++c)
      largest[c] = std::max(largest[c], keys.chains[c].worst_case_us);
  }
  for (const Handover& change : tables.handovers)
    for (std::size_t c = 0; c < largest.size(); ++c)
      largest[c] = std::max(largest[c], change.worst_case_us[c].value_or(0));
  return largest;
}

void set_priorities(Tables& tables) {
  for (std::size_t t = 0; t < tables.keys.size(); ++t) {
    const PriorityPlan by_keys = assignment_of(tables.keys[t]);
    for (std::size_t i = 0; i < by_keys.placements.size(); ++i)
      tables.tables[t].priority[i] = by_keys.placements[i].priority;
  }
}

void set_figures(Tables& tables, const AppSpec& app) {
  for (Served& served : tables.serves) {
    std::vector<std::int64_t> worst;
    for (const ChainClaim& claim : tables.keys[at(served.table)].chains)
      worst.push_back(claim.worst_case_us);
    const Objective of = chain_objective(app, worst),
                    least = chain_objective(app, served.chain_bound_us);
    served.worst_case_us = of.sum_us;
    served.lower_bound_us = least.sum_us;
    if (of.chain < 0) continue;
    served.worst_case_us = worst[at(of.chain)];
    served.lower_bound_us = static_cast<std::int64_t>(
        least.late * static_cast<double>(*app.chains[at(of.chain)].deadline_us));
  }
}

PriorityPlan whole_policy(const Tables& tables, std::size_t table, const AppSpec& app,
                          const Platform& platform) {
  Table whole = tables.tables[table];
  const Table& first = tables.tables[at(tables.serves.front().table)];
  for (std::size_t i = 0; i < whole.xpu.size(); ++i) {
    if (whole.xpu[i] >= 0) continue;
    whole.xpu[i] = first.xpu[i];
    whole.priority[i] = first.priority[i];
  }
  whole.loss = {};
  return policy_under(whole, app, platform, {});
}

namespace {

/// XNode, variant, XPU.
std::set<std::tuple<std::size_t, int, int>> made_by(const Tables& tables) {
  std::set<std::tuple<std::size_t, int, int>> made;
  for (const Table& table : tables.tables)
    for (std::size_t i = 0; i < table.xpu.size(); ++i)
      if (table.xpu[i] >= 0) made.emplace(i, table.loss.variant_of(i), table.xpu[i]);
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
  for (std::size_t i = 0; i < a.xpu.size(); ++i)
    if (a.xpu[i] >= 0 && b.xpu[i] >= 0 &&
        (a.xpu[i] != b.xpu[i] || a.loss.variant_of(i) != b.loss.variant_of(i)))
      ++count;
  return count;
}

namespace {

/// Every XNode that is not off has a place, in itself and beside the others.
Status validate(const Table& table, const AppSpec& app, const Platform& platform,
                const std::string& where) {
  if (table.xpu.size() != app.xnodes.size() || table.priority.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid, "does not place every XNode", where + "/xnodes");
  XAUTO_TRY(validate(table.loss, app, where));
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const bool off = table.loss.is_off(app.xnodes[i].module);
    if (off == (table.xpu[i] < 0)) continue;
    return fail(ErrorCode::kInvalid,
                "XNode '" + app.xnodes[i].name + "' is " +
                    (off ? "placed, and its module is off" : "not placed"),
                where + "/xnodes");
  }
  for (const auto& [u, v] : table.order)
    for (const int i : {u, v})
      if (table.xpu[at(i)] < 0)
        return fail(ErrorCode::kInvalid,
                    "names XNode '" + app.xnodes[at(i)].name + "', whose module is off",
                    where + "/order");
  if (!app.one_at_a_time) return {};  // its keys say more (validate_keys)
  if (Status valid =
          validate(policy_under(table, app, platform, {}), app_with(app, table.loss), platform);
      !valid) {
    Error error = std::move(valid).error();
    error.where = where + error.where;
    return tl::unexpected<Error>(std::move(error));
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

/// Of tables of keys: what the file says beyond placements.
Status validate_keys(const Tables& tables, const AppSpec& app, const Platform& platform) {
  const auto is_time = [](std::int64_t us) { return us >= 0 && us <= kMaxTimeUs; };
  if (tables.keys.size() != tables.tables.size())
    return fail(ErrorCode::kInvalid, "not every table has keys", "/tables");
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Scenario all = envelope(tables, t, app);
    const Loss& loss = tables.tables[t].loss;
    std::vector<std::int64_t> worst;
    for (const ChainClaim& claim : tables.keys[t].chains) worst.push_back(claim.worst_case_us);
    std::vector<char> there(app.chains.size(), 0);
    for (const int c : kept_chains(app, loss)) there[at(c)] = 1;
    if (tables.keys[t].placements.size() != app.xnodes.size() || !are_of_chains(worst, there))
      return fail(
          ErrorCode::kInvalid,
          "does not place every XNode, or has no worst case for each chain without a module "
          "that is off, and for these alone",
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
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const std::string place = "/serves/" + std::to_string(s);
    const std::vector<std::int64_t>& bounds = tables.serves[s].chain_bound_us;
    if (!are_of_chains(bounds, chains_of(tables.keys[at(tables.serves[s].table)])))
      return fail(ErrorCode::kInvalid,
                  "has no lower bound for each chain of its table, or one too many",
                  place + "/chains");
  }
  if (!is_time(tables.notice_us)) return fail(ErrorCode::kInvalid, "is out of range", "/notice_us");
  XAUTO_TRY(validate_pairs(tables.handovers, tables.tables, "/handovers",
                           "are not all from one table to another, each once", "that"));
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
  if (tables.keys.empty() != app.one_at_a_time)
    return fail(ErrorCode::kInvalid,
                app.one_at_a_time ? "have keys, and no source has a rate" : "have no keys",
                "/tables", "solve again");
  if (app.one_at_a_time) XAUTO_TRY(may_have_priorities(app));
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
    XAUTO_TRY(validate(table, app, platform, at));
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
    if (served.worst_case_us < 0 || served.worst_case_us > kMaxTimeUs ||
        served.lower_bound_us < 0 || served.lower_bound_us > kMaxTimeUs)
      return fail(ErrorCode::kInvalid, "a time is out of range", at);
  }
  if (!tables.keys.empty()) return validate_keys(tables, app, platform);
  return validate_pairs(tables.changes, tables.scenarios, "/changes",
                        "are not all changes between two scenarios, each once", "the change");
}

}  // namespace xauto

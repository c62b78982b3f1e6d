// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/sequence.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "solver/keys/certificate.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

void set_sequence_keys(const Problem& problem, const std::vector<int>& sequence, Policy& policy) {
  std::vector<Tick> end(policy.placements.size(), 0), free(at(problem.num_xpus), 0);
  for (const int i : sequence) {
    Placement& placed = policy.placements[at(i)];
    Tick ready = std::max(free[at(placed.xpu)],
                          problem.root[at(i)] != 0 ? problem.root_ready[at(i)] : Tick{0});
    for (const EdgeEnd& link : problem.pred[at(i)])
      ready = std::max(
          ready, end[at(link.xnode)] +
                     problem.transfer(link, policy.placements[at(link.xnode)].xpu, placed.xpu));
    for (const std::int64_t hold : placed.hold_us) ready = std::max(ready, hold * problem.scale);
    end[at(i)] = free[at(placed.xpu)] = problem.up_to_us(ready + problem.wcet(i, placed.xpu));
    placed.key_us = {end[at(i)] / problem.scale};
  }
}

std::optional<std::vector<int>> sequence_of(const Policy& policy) {
  std::vector<int> sequence(policy.placements.size());
  std::iota(sequence.begin(), sequence.end(), 0);
  const auto key = [&](int i) { return policy.placements[at(i)].key_us.front(); };
  std::ranges::stable_sort(sequence, {}, key);
  std::vector<std::pair<int, std::int64_t>> seen;  // XPU, key
  for (const int i : sequence) seen.emplace_back(policy.placements[at(i)].xpu, key(i));
  std::ranges::sort(seen);
  if (std::ranges::adjacent_find(seen) != seen.end()) return std::nullopt;
  return sequence;
}

std::optional<std::vector<std::int64_t>> sequence_claims(const Tables& tables, std::size_t table,
                                                         const AppSpec& app,
                                                         const Platform& platform,
                                                         const Scenario& scenario) {
  const Loss& loss = tables.tables[table].loss;
  const AppSpec left = app_under(app, scenario, loss);
  Policy policy = keys_under(tables, table, app, platform, scenario);
  const auto sequence = sequence_of(policy);
  const auto problem = Problem::create(
      left, platform_with(platform_under(platform, scenario), loss.off), {}, policy.order);
  if (!sequence || !problem) return std::nullopt;
  std::vector<int> xpu;
  for (const Placement& placed : policy.placements) {
    if (placed.xpu < 0 ||
        problem->wcet_flat[xpu.size() * at(problem->num_xpus) + at(placed.xpu)] == kNoTick)
      return std::nullopt;
    xpu.push_back(placed.xpu);
  }
  set_sequence_keys(*problem, *sequence, policy);
  Windows w = keys_and_holds(*problem, policy);
  if (!certify(*problem, xpu, w)) return std::nullopt;
  std::vector<std::int64_t> claims;
  for (const ChainSpec& chain : left.chains)
    claims.push_back(policy.placements[at(chain.to)].key_us.front());
  return claims;
}

void set_claims(Tables& tables, const AppSpec& app, const Platform& platform) {
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    Served& served = tables.serves[s];
    served.chain_worst_us = worst_cases(tables.tables[at(served.table)].keys);
    if (!app.one_at_a_time) continue;
    const auto own = sequence_claims(tables, at(served.table), app, platform, tables.scenarios[s]);
    if (!own) continue;
    const std::vector<int> there = kept_chains(app, tables.tables[at(served.table)].loss);
    for (std::size_t k = 0; k < there.size(); ++k) {
      std::int64_t& claim = served.chain_worst_us[at(there[k])];
      claim = std::min(claim, (*own)[k]);
    }
  }
  set_figures(tables, app);
}

namespace {

Handover release_across(const Tables& tables, int from, int to, const AppSpec& app,
                        const Platform& platform) {
  Handover handover{from, to, std::vector<std::optional<std::int64_t>>(app.chains.size())};
  const Scenario all = envelope(tables, at(to), app);
  if (needs_lost(tables.tables[at(from)], platform, all)) {
    handover.not_claimed.emplace_back("it may need an XPU that is lost");
    return handover;
  }
  const auto claims = sequence_claims(tables, at(from), app, platform,
                                      across(app, envelope(tables, at(from), app), all));
  if (!claims)
    handover.not_claimed.emplace_back("its keys do not say who goes first at longer WCETs");
  const std::vector<int> there = kept_chains(app, tables.tables[at(from)].loss);
  for (std::size_t c = 0; c < app.chains.size(); ++c)
    if (!both_have(tables, from, to, c)) handover.worst_case_us[c] = kNotThere;
  for (std::size_t k = 0; claims && k < there.size(); ++k)
    if (both_have(tables, from, to, at(there[k])))
      handover.worst_case_us[at(there[k])] = (*claims)[k];
  return handover;
}

}  // namespace

std::vector<Handover> releases_across(const Tables& tables, const AppSpec& app,
                                      const Platform& platform) {
  std::vector<Handover> all;
  const auto n = static_cast<int>(tables.tables.size());
  for (int from = 0; from < n; ++from)
    for (int to = 0; to < n; ++to)
      if (from != to) all.push_back(release_across(tables, from, to, app, platform));
  return all;
}

}  // namespace xauto::solver::keys

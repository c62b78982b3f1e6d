// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/one_release.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "solver/bounds.h"
#include "solver/keys/sequence.h"
#include "solver/order.h"
#include "solver/search.h"

namespace xauto::solver::keys {
namespace {

/// `keep`: [xnode] whether it is in it. With the wishes that are of those.
struct OneRelease {
  AppSpec app;
  Objectives wishes;
};
OneRelease part_of(const AppSpec& app, const Objectives& wishes, const std::vector<char>& keep) {
  OneRelease part;
  part.app.name = app.name;
  std::vector<int> number(app.xnodes.size(), -1);
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    if (keep[i] == 0) continue;
    number[i] = static_cast<int>(part.app.xnodes.size());
    XNodeSpec x = app.xnodes[i];
    x.sources.clear();
    x.variants.clear();
    part.app.xnodes.push_back(std::move(x));
  }
  for (const auto& [u, v] : app.edges)
    if (number[at(u)] >= 0 && number[at(v)] >= 0)
      part.app.edges.emplace_back(number[at(u)], number[at(v)]);
  const auto known = [&](const std::string& name) { return part.app.find(name) >= 0; };
  for (const auto& pin : wishes.pins)
    if (known(pin.first)) part.wishes.pins.push_back(pin);
  for (const auto& forbid : wishes.forbids)
    if (known(forbid.first)) part.wishes.forbids.push_back(forbid);
  for (const auto& group : wishes.groups) {
    std::vector<std::string> there;
    std::copy_if(group.begin(), group.end(), std::back_inserter(there), known);
    if (there.size() > 1) part.wishes.groups.push_back(std::move(there));
  }
  return part;
}

/// Of chains within one component, since what a sample reads is of another release.
void add_deadlines(const AppSpec& app, const Problem& p, Objectives& wishes) {
  for (std::size_t c = 0; c < p.chains.size(); ++c) {
    const Chain& chain = p.chains[c];
    const bool direct = std::any_of(chain.paths.begin(), chain.paths.end(),
                                    [](const Path& path) { return path.samples.empty(); });
    if (!app.chains[c].deadline_us || !direct) continue;
    for (int i = 0; i < p.num_xnodes; ++i) {
      const std::vector<int>& heard = app.xnodes[at(i)].sources;
      if (std::find(heard.begin(), heard.end(), chain.source) == heard.end() ||
          (i != chain.to && !p.before(i, chain.to)))
        continue;
      wishes.chains.push_back(
          {chain.name, p.xnode_name[at(i)], p.xnode_name[at(chain.to)], app.chains[c].deadline_us});
      break;
    }
  }
}

/// What `to` waits for by edges, and when the first of its roots hears, at the latest.
OneRelease behind(const AppSpec& app, const Problem& p, int to, const Objectives& wishes,
                  Tick& earliest) {
  std::vector<char> keep(at(p.num_xnodes), 0);
  earliest = kMostTicks;
  for (int i = 0; i < p.num_xnodes; ++i) {
    if (i != to && !p.before(i, to)) continue;
    keep[at(i)] = 1;
    if (p.root[at(i)] != 0) earliest = std::min(earliest, p.root_ready[at(i)]);
  }
  return part_of(app, wishes, keep);
}

/// The plan as keys. Where some suspend others each is held until its start: nobody else preempts then than does so in
/// the plan.
Policy as_keys(const AppSpec& app, const Platform& platform, const PriorityPlan& plan, Tick late) {
  std::vector<int> xpu;
  std::vector<Time> start, finish;
  for (const PriorityPlacement& placed : plan.placements) {
    xpu.push_back(placed.xpu);
    start.push_back(placed.start_us);
    finish.push_back(placed.finish_us);
  }
  const std::vector<char> held =
      where_some_suspend(static_cast<int>(platform.xpus.size()), xpu, start, finish);
  Policy policy = by_priorities(plan, app);
  policy.certified = true;  // as far as it is: whoever takes it certifies it
  for (std::size_t i = 0; i < xpu.size(); ++i) {
    policy.placements[i] = {xpu[i], {finish[i] + late}};
    if (held[at(xpu[i])] != 0 && start[i] > 0) policy.placements[i].hold_us = {start[i] + late};
  }
  return policy;
}

/// On each XPU one after the other, as they start in the plan; each ends when its longest way is over.
void put_in_sequence(const Problem& p, Policy& policy, const PriorityPlan& plan) {
  std::vector<int> all(plan.placements.size());
  std::iota(all.begin(), all.end(), 0);
  std::stable_sort(all.begin(), all.end(), [&](int a, int b) {
    const PriorityPlacement &one = plan.placements[at(a)], &other = plan.placements[at(b)];
    return std::tie(one.start_us, one.finish_us) < std::tie(other.start_us, other.finish_us);
  });
  std::map<int, int> last_on;
  for (const int i : all) {
    const auto [last, first] = last_on.emplace(plan.placements[at(i)].xpu, i);
    if (first) continue;
    policy.order.emplace_back(last->second, i);
    last->second = i;
  }
  set_sequence_keys(p, all, policy);
}

/// Who ends last of all is then the end of a chain, which hears of it directly; and no source of one is later than
/// its component.
bool every_end_is_a_chain(const Problem& p) {
  std::vector<char> ends(at(p.num_xnodes), 0);
  for (const Chain& chain : p.chains)
    if (chain.offset == p.components[at(p.component_of[at(chain.to)])].phase &&
        std::any_of(chain.paths.begin(), chain.paths.end(),
                    [](const Path& path) { return path.samples.empty(); }))
      ends[at(chain.to)] = 1;
  for (int i = 0; i < p.num_xnodes; ++i)
    if (p.succ[at(i)].empty() && ends[at(i)] == 0) return false;
  return true;
}

}  // namespace

Result<ReleasePlan> plan_of_one_release(const AppSpec& app, const Platform& platform,
                                        const Problem& p, SolveOptions options) {
  for (std::size_t c = 1; c < p.components.size(); ++c)
    if (!p.released_together(0, static_cast<int>(c)))
      return fail(ErrorCode::kUnavailable, "its XNodes are not all released together", app.name);
  OneRelease whole = part_of(app, options.objectives, std::vector<char>(app.xnodes.size(), 1));
  // The baselines have no order of their own, and know of no chains; nor does the paper's model know of chains.
  const bool model = options.method == "ilp";
  const bool keeps_order = options.method == "auto" || options.method == "search" || model;
  const bool alike = std::all_of(p.chains.begin(), p.chains.end(), [&](const Chain& c) {
    return c.deadline == p.chains.front().deadline;
  });
  // Where every end has the same deadline the last end says all, and the search for it alone is better.
  if (keeps_order && !model && !(alike && every_end_is_a_chain(p)))
    add_deadlines(app, p, whole.wishes);
  options.objectives = std::move(whole.wishes);
  options.all_nested_pay = keeps_order;
  // Of large apps any plan is seldom shorter than what has order, in the time that there is (docs/results/solver.txt).
  options.ordered_only = keeps_order && whole.app.xnodes.size() > at(kLarge);
  SolveReport report;
  options.report = &report;
  XAUTO_ASSIGN(const PriorityPlan plan, solver::solve(whole.app, platform, options));
  // Nobody hears before the latest of the roots.
  const Tick late =
      p.up_to_us(*std::max_element(p.root_ready.begin(), p.root_ready.end())) / p.scale;
  ReleasePlan found;
  found.policies.push_back(as_keys(app, platform, plan, late));
  if (!keeps_order)
    put_in_sequence(p, found.policies.front(), plan);
  else if (report.ordered)
    found.policies.push_back(as_keys(app, platform, *report.ordered, late));
  found.proof = std::move(report.proof);
  const Tick first = *std::min_element(p.root_ready.begin(), p.root_ready.end());
  if (every_end_is_a_chain(p)) found.bound = first + plan.lower_bound_us * p.scale;
  return found;
}

Result<Baseline> baseline(const AppSpec& app, const Platform& platform,
                          const SolveOptions& options) {
  XAUTO_ASSIGN(const PriorityPlan plan, solver::solve(app, platform, options));
  return Baseline{by_priorities(plan, app), plan.latency_us};
}

Result<Policy> fixed_priorities(const AppSpec& app, const Platform& platform,
                                SolveOptions options) {
  options.priorities_only = true;
  XAUTO_ASSIGN(PriorityPlan plan, solver::solve(app, platform, options));
  std::vector<std::int64_t> priority;
  for (const PriorityPlacement& p : plan.placements) priority.push_back(p.priority);
  std::vector<int> sequence = solver::sequence_of(priority);
  const std::vector<std::int64_t> periods = app.periods();
  const auto period = [&](int i) { return periods[at(i)] > 0 ? periods[at(i)] : kMaxPeriodUs + 1; };
  std::stable_sort(sequence.begin(), sequence.end(),
                   [&](int a, int b) { return period(a) < period(b); });
  auto next = static_cast<std::int64_t>(sequence.size());
  for (const int i : sequence) plan.placements[at(i)].priority = next--;
  plan.order.clear();
  return by_priorities(plan, app);
}

Tick quick_release_bound(const AppSpec& app, const Platform& platform, const Problem& p, int to,
                         const Objectives& wishes, const Until& until) {
  Tick earliest = 0;
  const OneRelease part = behind(app, p, to, wishes, earliest);
  Result<solver::Problem> base = solver::Problem::create(part.app, platform);
  if (!base || !resolve(part.wishes, part.app, platform, *base)) return 0;
  return earliest + quick_bound(*base, until) * p.scale;
}

Tick one_release_bound(const AppSpec& app, const Platform& platform, const Problem& p, int to,
                       SolveOptions options) {
  Tick earliest = 0;
  OneRelease part = behind(app, p, to, options.objectives, earliest);
  options.objectives = std::move(part.wishes);
  options.all_nested_pay = true;
  const Result<PriorityPlan> plan = solver::solve(part.app, platform, options);
  return plan ? earliest + plan->lower_bound_us * p.scale : 0;
}

}  // namespace xauto::solver::keys

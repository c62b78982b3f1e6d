// SPDX-License-Identifier: Apache-2.0
// See objectives.h.
#include "solver/objectives.h"

#include <algorithm>

#include "base/index.h"

namespace xauto::solver {
namespace {

Result<int> xnode_named(const AppSpec& app, const std::string& name, const std::string& where) {
  const int i = app.find(name);
  if (i < 0) return fail(ErrorCode::kInvalid, "no XNode is called '" + name + "'", where);
  return i;
}

/// Instances that `name` means: one XPU id, or all of a type.
Result<std::vector<int>> xpus_named(const Platform& platform, const std::string& name,
                                    const std::string& where) {
  if (const int x = platform.find(name); x >= 0) return std::vector<int>{x};
  std::vector<int> instances = platform.instances_of(name);
  if (instances.empty())
    return fail(ErrorCode::kInvalid, "no XPU and no type is called '" + name + "'", where);
  return instances;
}

bool reaches(const Problem& problem, int from, int to) {
  std::vector<char> seen(at(problem.num_xnodes), 0);
  std::vector<int> queue = {from};
  while (!queue.empty()) {
    const int i = queue.back();
    queue.pop_back();
    if (i == to) return true;
    if (seen[at(i)]) continue;
    seen[at(i)] = 1;
    queue.insert(queue.end(), problem.succ[at(i)].begin(), problem.succ[at(i)].end());
  }
  return false;
}

void forbid(Problem& problem, int xnode, int xpu) {
  if (problem.forbidden.empty())
    problem.forbidden.assign(at(problem.num_xnodes) * at(problem.num_xpus), 0);
  problem.forbidden[at(xnode) * at(problem.num_xpus) + at(xpu)] = 1;
}

bool may_run(const Problem& problem, int xnode, int xpu) {
  return problem.wcet_on(xnode, xpu) != kCannotRun;
}

}  // namespace

Status resolve(const Objectives& objectives, const AppSpec& app, const Platform& platform,
               Problem& problem) {
  for (const auto& [name, target] : objectives.forbids) {
    XAUTO_ASSIGN(const int i, xnode_named(app, name, "forbids"));
    XAUTO_ASSIGN(const std::vector<int> xpus, xpus_named(platform, target, "forbids"));
    for (int x : xpus) forbid(problem, i, x);
  }
  for (const auto& [name, target] : objectives.pins) {
    XAUTO_ASSIGN(const int i, xnode_named(app, name, "pins"));
    XAUTO_ASSIGN(const std::vector<int> xpus, xpus_named(platform, target, "pins"));
    for (int x = 0; x < problem.num_xpus; ++x)
      if (std::find(xpus.begin(), xpus.end(), x) == xpus.end()) forbid(problem, i, x);
  }
  for (const auto& names : objectives.groups) {
    std::vector<int> group;
    for (const std::string& name : names) {
      XAUTO_ASSIGN(const int i, xnode_named(app, name, "groups"));
      group.push_back(i);
      for (const auto& other : problem.groups)
        if (std::find(other.begin(), other.end(), i) != other.end())
          return fail(ErrorCode::kInvalid, "XNode '" + name + "' is in two groups", "groups");
    }
    bool any = false;
    for (int x = 0; x < problem.num_xpus; ++x) {
      const bool all =
          std::all_of(group.begin(), group.end(), [&](int i) { return may_run(problem, i, x); });
      any = any || all;
      if (!all)
        for (int i : group) forbid(problem, i, x);
    }
    if (!any && !group.empty())
      return fail(ErrorCode::kInfeasible,
                  "no XPU can run all of the group of '" + names.front() + "'", "groups");
    if (group.size() > 1) problem.groups.push_back(std::move(group));
  }
  // A type of which no instance is left is no implementation any more: the bounds see that.
  for (int i = 0; i < problem.num_xnodes && !problem.forbidden.empty(); ++i) {
    bool any = false;
    for (int t = 0; t < problem.num_types; ++t) {
      const auto& instances = problem.type_xpus[at(t)];
      const bool usable = std::any_of(instances.begin(), instances.end(),
                                      [&](int x) { return may_run(problem, i, x); });
      if (!usable) problem.wcet_flat[at(i) * at(problem.num_types) + at(t)] = kCannotRun;
      any = any || usable;
    }
    if (!any)
      return fail(ErrorCode::kInfeasible,
                  "XNode '" + app.xnodes[at(i)].name + "' has no XPU left to run on", "pins");
  }
  for (const ChainWish& chain : objectives.chains) {
    XAUTO_ASSIGN(const int from, xnode_named(app, chain.from, "chains"));
    XAUTO_ASSIGN(const int to, xnode_named(app, chain.to, "chains"));
    if (!reaches(problem, from, to))
      return fail(ErrorCode::kInvalid, "'" + chain.to + "' does not depend on '" + chain.from + "'",
                  "chains: " + chain.name);
    Goal& goal = problem.goal;
    if (goal.deadline.empty()) goal.deadline.assign(at(problem.num_xnodes), Goal::kNone);
    if (chain.deadline_us)
      goal.deadline[at(to)] = std::min(goal.deadline[at(to)], *chain.deadline_us);
  }
  return {};
}

}  // namespace xauto::solver

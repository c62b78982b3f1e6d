// SPDX-License-Identifier: Apache-2.0
#include "model/priority_plan.h"

#include <map>
#include <set>

#include "base/index.h"

namespace xauto {
namespace {

Status check_placements(const PriorityPlan& policy, const AppSpec& app, const Platform& platform) {
  if (policy.placements.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid,
                "places " + std::to_string(policy.placements.size()) + " XNodes, the app has " +
                    std::to_string(app.xnodes.size()),
                "/xnodes");
  std::map<std::pair<int, std::int64_t>, std::size_t> priorities;
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const PriorityPlacement& p = policy.placements[i];
    const std::string& name = app.xnodes[i].name;
    const std::string where = "/xnodes/" + std::to_string(i);
    const std::string who = "XNode '" + name + "' ";
    if (p.xpu < 0 || at(p.xpu) >= platform.xpus.size())
      return fail(ErrorCode::kInvalid, who + "is on no XPU of platform '" + platform.name + "'",
                  where + "/xpu");
    const Xpu& xpu = platform.xpus[at(p.xpu)];
    if (!app.xnodes[i].wcet_on(xpu.type))
      return fail(ErrorCode::kInvalid,
                  who + "is on " + xpu.id + " but has no implementation for '" + xpu.type + "'",
                  where + "/xpu");
    if (p.priority < -kMaxTimeUs || p.priority > kMaxTimeUs)
      return fail(ErrorCode::kInvalid,
                  who + "has priority " + std::to_string(p.priority) + ", out of range",
                  where + "/priority");
    const auto [other, added] = priorities.try_emplace({p.xpu, p.priority}, i);
    if (!added)
      return fail(ErrorCode::kInvalid,
                  who + "has priority " + std::to_string(p.priority) + " on " + xpu.id + ", as '" +
                      app.xnodes[other->second].name + "' has",
                  where + "/priority", "priorities are unique per XPU instance");
    if (p.start_us < 0 || p.finish_us < p.start_us || p.finish_us > kMaxTimeUs)
      return fail(ErrorCode::kInvalid,
                  who + "has start " + std::to_string(p.start_us) + " us and finish " +
                      std::to_string(p.finish_us) + " us, which make no interval",
                  where + "/finish_us");
  }
  return {};
}

}  // namespace

Status validate_order(const std::vector<std::pair<int, int>>& order, const std::vector<int>& xpu_of,
                      const AppSpec& app) {
  // The run-time order and the app's edges together must leave a way through.
  std::set<std::pair<int, int>> seen;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const auto [u, v] = order[i];
    const std::string where = "/order/" + std::to_string(i);
    if (u < 0 || v < 0 || at(u) >= app.xnodes.size() || at(v) >= app.xnodes.size())
      return fail(ErrorCode::kInvalid, "names an unknown XNode", where);
    const std::string pair =
        "'" + app.xnodes[at(u)].name + "' before '" + app.xnodes[at(v)].name + "'";
    if (u == v) return fail(ErrorCode::kInvalid, pair + " cannot be", where);
    if (xpu_of[at(u)] != xpu_of[at(v)])
      return fail(ErrorCode::kInvalid, pair + ": they are on different XPUs", where,
                  "run-time order is between XNodes of one XPU");
    if (!seen.insert({u, v}).second)
      return fail(ErrorCode::kInvalid, pair + " is there twice", where);
  }
  if (app.topological_order(order).size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid,
                "the order and the app's edges form a cycle: the app would hang", "/order");
  return {};
}

Status validate(const PriorityPlan& policy, const AppSpec& app, const Platform& platform) {
  const std::string hint =
      "solve again: `xauto solve --app app.json --platform ... --out policy.json`";
  if (policy.app != app.name)
    return fail(ErrorCode::kInvalid, "is for app '" + policy.app + "', this is '" + app.name + "'",
                "/app", hint);
  if (policy.app_hash != app.hash())
    return fail(ErrorCode::kInvalid,
                "is '" + policy.app_hash + "', the app's is '" + app.hash() +
                    "': the policy was made for another version of the app",
                "/app_hash", hint);
  XAUTO_TRY(check_placements(policy, app, platform));
  std::vector<int> xpu_of;
  for (const PriorityPlacement& p : policy.placements) xpu_of.push_back(p.xpu);
  XAUTO_TRY(validate_order(policy.order, xpu_of, app));
  const auto is_time = [](std::int64_t us) { return us >= 0 && us <= kMaxTimeUs; };
  if (!is_time(policy.latency_us))
    return fail(ErrorCode::kInvalid, std::to_string(policy.latency_us) + " is no latency",
                "/latency_us");
  if (!is_time(policy.lower_bound_us))
    return fail(ErrorCode::kInvalid, std::to_string(policy.lower_bound_us) + " is no bound",
                "/lower_bound_us");
  if (policy.worst_case_us && !is_time(*policy.worst_case_us))
    return fail(ErrorCode::kInvalid, std::to_string(*policy.worst_case_us) + " is no latency",
                "/worst_case_us");
  if (policy.solve_us < 0)
    return fail(ErrorCode::kInvalid, std::to_string(policy.solve_us) + " is no time", "/solve_us");
  return {};
}

}  // namespace xauto

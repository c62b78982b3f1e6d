// SPDX-License-Identifier: Apache-2.0
// What can be said of a PriorityPlan without a simulator: it is for this app (name and hash), every XNode is
// on an XPU of a type that it has an implementation for, priorities are unique per XPU, order pairs are
// between XNodes of one XPU and acyclic together with the edges, times are in range.
#pragma once

#include <map>

#include "base/index.h"
#include "model/priority_plan.h"

namespace xauto::reference {

inline Status check_placements(const PriorityPlan& policy, const AppSpec& app,
                               const Platform& platform) {
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

inline Status validate_plan(const PriorityPlan& policy, const AppSpec& app,
                            const Platform& platform) {
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
  if (policy.solve_us < 0)
    return fail(ErrorCode::kInvalid, std::to_string(policy.solve_us) + " is no time", "/solve_us");
  return {};
}

}  // namespace xauto::reference

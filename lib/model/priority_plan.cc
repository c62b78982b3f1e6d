// SPDX-License-Identifier: Apache-2.0
#include "model/priority_plan.h"

#include <set>

#include "base/index.h"

namespace xauto {

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

}  // namespace xauto

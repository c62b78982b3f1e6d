// SPDX-License-Identifier: Apache-2.0
#include "solver/problem.h"

#include <algorithm>
#include <numeric>

namespace xauto::solver {

Result<Problem> Problem::create(const AppSpec& app, const Platform& platform) {
  XAUTO_TRY(validate_graph(app));
  XAUTO_TRY(validate(platform));
  XAUTO_TRY(validate_on(app, platform));
  Problem p;
  p.num_xnodes = static_cast<int>(app.xnodes.size());
  p.num_xpus = static_cast<int>(platform.xpus.size());
  p.type_name = platform.types();
  p.num_types = static_cast<int>(p.type_name.size());
  p.type_xpus.resize(p.type_name.size());
  for (std::size_t m = 0; m < platform.xpus.size(); ++m) {
    const Xpu& xpu = platform.xpus[m];
    const auto type =
        std::find(p.type_name.begin(), p.type_name.end(), xpu.type) - p.type_name.begin();
    p.xpu_type.push_back(static_cast<int>(type));
    p.type_xpus[static_cast<std::size_t>(type)].push_back(static_cast<int>(m));
    p.preemptive.push_back(xpu.preemptive ? 1 : 0);
    p.preempt.push_back(xpu.preempt_us);
    p.levels.push_back(xpu.levels);
  }
  for (const XNodeSpec& x : app.xnodes)
    for (const std::string& type : p.type_name)
      p.wcet_flat.push_back(x.wcet_on(type).value_or(kCannotRun));
  p.pred = app.predecessors();
  p.succ = app.successors();
  p.topo = app.topological_order();
  return p;
}

std::vector<std::int64_t> priorities_by_key(const std::vector<Time>& key) {
  std::vector<int> order(key.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return key[static_cast<std::size_t>(a)] < key[static_cast<std::size_t>(b)];
  });
  std::vector<std::int64_t> priority(key.size());
  auto next = static_cast<std::int64_t>(key.size());
  for (const int i : order) priority[static_cast<std::size_t>(i)] = next--;
  return priority;
}

void Problem::let_all_nested_pay() {
  for (std::size_t x = 0; x < levels.size(); ++x)
    if (preemptive[x] != 0 && preempt[x] > 0 && levels[x] == 0) levels[x] = num_xnodes + 1;
}

}  // namespace xauto::solver

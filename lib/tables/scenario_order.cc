// SPDX-License-Identifier: Apache-2.0
#include "tables/scenario_order.h"

#include <algorithm>

namespace xauto::runtime {

ScenarioOrder::ScenarioOrder(const AppSpec& app, const Tables& tables) {
  std::vector<AppSpec> under;  // [scenario]
  for (const Scenario& scenario : tables.scenarios) under.push_back(app_under(app, scenario));
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    const Served& served = tables.serves[s];
    auto& row = covers_.emplace_back();
    for (std::size_t other = 0; other < under.size(); ++other)
      row.push_back(
          xauto::covers(tables.scenarios[s], under[s], tables.scenarios[other], under[other]) ? 1
                                                                                              : 0);
    rank_.emplace_back(loss_pct(tables.tables[static_cast<std::size_t>(served.table)].loss, app),
                       served.worst_case_us, std::count(row.begin(), row.end(), 1));
  }
}

}  // namespace xauto::runtime

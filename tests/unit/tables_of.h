// SPDX-License-Identifier: Apache-2.0
// Tables as tests write them by hand.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "model/tables.h"

namespace xauto::test {

/// Each chain that the loss leaves takes what the key of its end says.
inline Table table_of(const AppSpec& app, std::string name, const std::vector<int>& xpu,
                      const std::vector<std::int64_t>& key_us, Loss loss = {}) {
  Table table;
  table.name = std::move(name);
  table.loss = std::move(loss);
  for (std::size_t i = 0; i < xpu.size(); ++i)
    table.keys.placements.push_back({xpu[i], {key_us[i]}});
  for (const ChainSpec& chain : app.chains) table.keys.chains.push_back({chain.name, kNotThere});
  for (const int c : kept_chains(app, table.loss)) {
    const auto k = static_cast<std::size_t>(c);
    table.keys.chains[k].worst_case_us = key_us[static_cast<std::size_t>(app.chains[k].to)];
  }
  return table;
}

/// A scenario more, which is served by that table: what the table claims, and no chain takes less than `bound_us`.
inline void serve(Tables& tables, const AppSpec& app, int table, std::int64_t bound_us = 1) {
  Served& served = tables.serves.emplace_back();
  served.table = table;
  served.chain_worst_us = worst_cases(tables.tables[static_cast<std::size_t>(table)].keys);
  for (const std::int64_t us : served.chain_worst_us)
    served.chain_bound_us.push_back(us == kNotThere ? kNotThere : bound_us);
  set_figures(tables, app);
}

}  // namespace xauto::test

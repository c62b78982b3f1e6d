// SPDX-License-Identifier: Apache-2.0
#include "runtime/claimed_wcets.h"

#include <algorithm>

#include "runtime/placing.h"

namespace xauto::runtime {

ClaimedWcets::ClaimedWcets(const Session& session) : xnodes_(session.app.xnodes.size()) {
  const Tables& tables = *session.tables;
  const auto table_of = [&](std::size_t scenario) { return tables.serves[scenario].table; };
  const std::size_t jobs = tables.tables.size() * xnodes_;
  for (const Scenario& scenario : tables.scenarios) {
    const AppSpec under = app_under(session.app, scenario);
    auto& row = ns_.emplace_back(jobs);
    for (std::size_t t = 0; t < tables.tables.size(); ++t)
      for (std::size_t x = 0; x < xnodes_; ++x) {
        const Table& table = tables.tables[t];
        if (table.xpu[x] < 0) continue;
        const std::string& type =
            session.platform.xpus[static_cast<std::size_t>(table.xpu[x])].type;
        if (const auto wcet_us = wcet_of(under.xnodes[x], table.loss.variant_of(x), type))
          row[at(t, x)] = watched_ns(*wcet_us, session.emulated(table.xpu[x]));
      }
  }
  if (session.keys) {  // a table's claims are of all that it serves
    const auto own = ns_;
    for (std::size_t s = 0; s < ns_.size(); ++s)
      for (std::size_t other = 0; other < ns_.size(); ++other)
        for (std::size_t j = 0; j < jobs && table_of(other) == table_of(s); ++j)
          ns_[s][j] = std::max(ns_[s][j], own[other][j]);
  }
  least_ns_.resize(jobs);
  for (std::size_t s = 0; s < ns_.size(); ++s)
    for (std::size_t x = 0; x < xnodes_; ++x) {
      const std::size_t job = at(static_cast<std::size_t>(table_of(s)), x);
      if (ns_[s][job] > 0 && (least_ns_[job] == 0 || ns_[s][job] < least_ns_[job]))
        least_ns_[job] = ns_[s][job];
    }
}

std::int64_t ClaimedWcets::under(std::size_t scenario, std::size_t table, std::size_t xnode) const {
  return ns_[scenario][at(table, xnode)];
}

std::int64_t ClaimedWcets::least(std::size_t table, std::size_t xnode) const {
  return least_ns_[at(table, xnode)];
}

}  // namespace xauto::runtime

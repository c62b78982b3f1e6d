// SPDX-License-Identifier: Apache-2.0
#include "session/claimed_wcets.h"

#include <algorithm>

#include "model/claims.h"

namespace xauto::runtime {

std::int64_t watched_ns(std::int64_t wcet_us, bool emulated) {
  return emulated ? wcet_us * (100 + kEmulatorPct) * 10 + kEmulatorUs * 1000 : wcet_us * 1000;
}

ClaimedWcets::ClaimedWcets(const Session& session) : xnodes_(session.app.xnodes.size()) {
  const Tables& tables = *session.tables;
  const std::size_t jobs = tables.tables.size() * xnodes_;
  const bool by_scenario = session.app.one_at_a_time;
  shortest_ns_.resize(jobs);
  ns_.assign(by_scenario ? tables.scenarios.size() : tables.tables.size(),
             std::vector<std::int64_t>(jobs));
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    row_of_.push_back(by_scenario ? s : static_cast<std::size_t>(tables.serves[s].table));
    const AppSpec under = app_under(session.app, tables.scenarios[s]);
    std::vector<std::int64_t>& row = ns_[row_of_[s]];
    for (std::size_t t = 0; t < tables.tables.size(); ++t)
      for (std::size_t x = 0; x < xnodes_; ++x) {
        const Table& table = tables.tables[t];
        if (table.xpu(x) < 0) continue;
        const std::string& type =
            session.platform.xpus[static_cast<std::size_t>(table.xpu(x))].type;
        const auto wcet_us = wcet_of(under.xnodes[x], table.loss.variant_of(x), type);
        if (!wcet_us) continue;
        const std::int64_t ns = watched_ns(*wcet_us, session.emulated(table.xpu(x)));
        std::int64_t& shortest = shortest_ns_[at(t, x)];
        row[at(t, x)] = std::max(row[at(t, x)], ns);
        shortest = shortest == 0 ? ns : std::min(shortest, ns);
      }
  }
  least_ns_.resize(jobs);
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s)
    for (std::size_t x = 0; x < xnodes_; ++x) {
      const std::size_t job = at(static_cast<std::size_t>(tables.serves[s].table), x);
      const std::int64_t ns = ns_[row_of_[s]][job];
      if (ns > 0 && (least_ns_[job] == 0 || ns < least_ns_[job])) least_ns_[job] = ns;
    }
}

std::int64_t ClaimedWcets::under(std::size_t scenario, std::size_t table, std::size_t xnode) const {
  return ns_[row_of_[scenario]][at(table, xnode)];
}

std::int64_t ClaimedWcets::least(std::size_t table, std::size_t xnode) const {
  return least_ns_[at(table, xnode)];
}

}  // namespace xauto::runtime

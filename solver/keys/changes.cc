// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/changes.h"

#include <algorithm>
#include <utility>

#include "base/index.h"
#include "solver/choose_tables.h"
#include "solver/keys/certificate.h"

namespace xauto::solver::keys {
namespace {

/// Of keys that were certified for the same times.
Result<Windows> windows_of(const Problem& p, const Policy& keys, const std::vector<int>& xpu) {
  Windows w = keys_and_holds(p, keys);
  std::string why;
  if (!certify(p, xpu, w, &why))
    return fail(ErrorCode::kInternal, "a table does not hold for what it serves: " + why, "tables",
                "please report this");
  return w;
}

}  // namespace

Result<Changes> Changes::create(const Tables& tables, const AppSpec& app,
                                const Platform& platform) {
  Changes changes(app, platform);
  changes.tables_ = tables;
  changes.of_all_ = platform_of_all(tables, platform);
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    Prepared of;
    of.envelope = envelope(tables, t, app);
    XAUTO_ASSIGN(of.problem, changes.problem_of(of.envelope, t));
    of.xpu = xpus_on(changes.of_all_, tables.tables[t], app);
    XAUTO_ASSIGN(of.windows, windows_of(of.problem, tables.tables[t].keys, of.xpu));
    changes.prepared_.push_back(std::move(of));
  }
  return changes;
}

Result<Problem> Changes::problem_of(const Scenario& scenario, std::size_t table) const {
  return Problem::create(app_of_all_chains(app_under(*app_, scenario), tables_.tables[table].loss),
                         of_all_);
}

Result<Handover> Changes::between(int from, int to, const Until& until) const {
  Handover handover;
  handover.from = from;
  handover.to = to;
  handover.worst_case_us.resize(app_->chains.size());
  const Prepared &p = prepared_[at(from)], &q = prepared_[at(to)];
  if (needs_lost(tables_.tables[at(from)], *platform_, q.envelope)) {
    handover.not_claimed.emplace_back("it may need an XPU that is lost");
    return handover;
  }
  XAUTO_ASSIGN(const Problem both, problem_of(across(*app_, p.envelope, q.envelope), at(from)));
  const HandoverBound bound = bound_handover({p.problem, q.problem, both, p.xpu, q.xpu, p.windows,
                                              q.windows, tables_.notice_us * both.scale},
                                             kMostWalked, until);
  const auto up = [&](Tick t) { return both.up_to_us(t) / both.scale; };
  for (std::size_t c = 0; c < bound.worst.size(); ++c)
    if (bound.worst[c] != kNoTick)
      handover.worst_case_us[c] = both_have(tables_, from, to, c) ? up(bound.worst[c]) : kNotThere;
  handover.settles_us = up(bound.settles);
  handover.not_claimed = bound.why_not;
  return handover;
}

ChangeCost cost_of(const std::vector<Handover>& handovers, const Tables& tables,
                   const AppSpec& app) {
  ChangeCost cost;
  int chains = 0;
  double length = 0, settles_us = 0;
  for (const Handover& h : handovers) {
    settles_us += static_cast<double>(h.settles_us);
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (!both_have(tables, h.from, h.to, c)) continue;
      const std::optional<std::int64_t> worst = h.worst_case_us[c];
      if (!worst) {
        ++cost.unclaimed;
        continue;
      }
      const auto own =
          static_cast<double>(std::max(tables.tables[at(h.from)].keys.chains[c].worst_case_us,
                                       tables.tables[at(h.to)].keys.chains[c].worst_case_us));
      const auto us = static_cast<double>(*worst);
      const auto deadline = static_cast<double>(app.chains[c].deadline_us.value_or(0));
      if (deadline > 0) cost.missed += std::max(0.0, us - std::max(own, deadline)) / deadline;
      length += us / std::max(1.0, deadline > 0 ? deadline : own);
      ++chains;
    }
  }
  cost.price =
      length / std::max(1, chains) +
      settles_us / kSettlesForUs / static_cast<double>(std::max<std::size_t>(1, handovers.size())) +
      kRegretOfAnInstance * static_cast<double>(instances(tables));
  return cost;
}

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Changes between the tables of a set, each with its worst case (handover.h), and what they cost together.
#pragma once

#include <tuple>
#include <vector>

#include <xauto/result.h>

#include "model/tables.h"
#include "solver/keys/handover.h"

namespace xauto::solver::keys {

/// Of several changes. In this order, less is better.
struct ChangeCost {
  int unclaimed = 0;  ///< chains that both tables have, and of which nothing is claimed
  double missed = 0;  ///< of worst case / deadline what is above 1 during a change alone, added up
  /// The mean worst case, relative to the deadline, or where there is none to the tables' own; the mean
  /// time until a change has settled, relative to kSettlesForUs; and kRegretOfAnInstance for each instance.
  double price = 0;
  bool operator<(const ChangeCost& o) const {
    return std::tie(unclaimed, missed, price) < std::tie(o.unclaimed, o.missed, o.price);
  }
};

/// A run keeps its table until a change has settled: so long is as bad as a chain longer by a deadline.
inline constexpr double kSettlesForUs = 10e6;

/// Thread safety: after create(), any number of threads.
class Changes {
 public:
  /// `tables` has all but handovers, and certified keys; kInternal: they do not hold. Keeps references to
  /// `app` and `platform`.
  static Result<Changes> create(const Tables& tables, const AppSpec& app, const Platform& platform);
  /// `until`: over, nothing is claimed. Errors: Problem::create.
  [[nodiscard]] Result<Handover> between(int from, int to, const Until& until) const;

 private:
  Changes(const AppSpec& app, const Platform& platform) : app_(&app), platform_(&platform) {}
  [[nodiscard]] Result<Problem> problem_of(const Scenario& scenario, std::size_t table) const;

  const AppSpec* app_;
  const Platform* platform_;
  Platform of_all_;
  Tables tables_;
  struct Prepared {
    Scenario envelope;
    Problem problem;
    std::vector<int> xpu;  ///< [xnode]
    Windows windows;
  };
  std::vector<Prepared> prepared_;  ///< [table]
};

/// Of all `handovers` of `tables`.
[[nodiscard]] ChangeCost cost_of(const std::vector<Handover>& handovers, const Tables& tables,
                                 const AppSpec& app);

}  // namespace xauto::solver::keys

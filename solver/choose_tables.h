// SPDX-License-Identifier: Apache-2.0
// Of candidates for tables the few that serve all scenarios best. For a regret r that is a set cover:
// an ILP of a binary per candidate and a row per scenario. The r are the candidates' own.
#pragma once

#include <atomic>
#include <limits>
#include <vector>

namespace xauto::solver {

/// Regret of a candidate under a scenario that it does not serve.
inline constexpr double kCannotServe = std::numeric_limits<double>::infinity();

struct TableChoice {
  std::vector<int> chosen;  ///< candidates; empty: as many as may be do not serve all
  std::vector<int> serves;  ///< [scenario] candidate
  double worst = kCannotServe;
};

/// `regret`: [candidate][scenario]. With `within` >= 1 the fewest candidates of at most that regret;
/// where there are none, and otherwise, the least largest regret with at most `most`. Best within the
/// time that lp_solve has; what it finds then is valid all the same.
[[nodiscard]] TableChoice choose_tables(const std::vector<std::vector<double>>& regret, int most,
                                        double within, const std::atomic<bool>* stop);

/// Each XNode has an instance on each XPU that some table in use gives it: one more has to be worth so
/// much regret. Chosen, not tuned.
inline constexpr double kRegretOfAnInstance = 0.0005;
/// The same choice, or one with other candidates in the place of some of it: with less largest regret +
/// mean regret + that of the instances, as found by replacing one after the other. What is at most
/// `within` counts alike. `xpu`: [candidate][XNode], -1: it is off.
[[nodiscard]] TableChoice fewer_instances(const std::vector<std::vector<double>>& regret,
                                          const std::vector<std::vector<int>>& xpu,
                                          const TableChoice& choice, double within);

}  // namespace xauto::solver

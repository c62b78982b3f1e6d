// SPDX-License-Identifier: Apache-2.0
// Few tables of keys for many scenarios: solver/tables.h, for an app whose sources have rates, or whose release has more
// than a length.
//
// The worst cases of keys follow from the keys alone, and keys that are certified hold for all that is
// component-wise below. So a table is a policy for an *envelope*, of each WCET the longest of the
// scenarios that it serves; its worst cases are the same in all of them.
//
//  0. Of an app with several clocks: can each have XPUs of its own, at little cost? Then changes
//     have a worst case.
//  1. Each scenario is solved alone: its lower bounds, and a candidate that serves what it covers.
//  2. Choice: of the candidates the K of least largest regret (choose_tables.h). The regret is of the
//     largest worst case relative to its deadline, over the same of the lower bounds; without
//     deadlines of the sums.
//  3. For each group of scenarios that a chosen one serves, and for each such group with one more that
//     limits, a search for its envelope, from that policy on. What comes of it is one more candidate.
//     Then 2 again.
//  4. A table that another chosen one nearly equals is spared.
//  5. From each table to each other one the worst case of the change (changes.h). Many policies are as
//     good for a table's scenarios, and differ in that. So the last fifth of the time is for searches
//     that begin with what the other tables do, or the table itself; two fifths where some change has
//     no worst case. What comes of them is taken where changes claim more, miss fewer deadlines, or are
//     shorter, and regrets grow by little.
#pragma once

#include "solver/tables.h"

namespace xauto::solver::keys {

/// From the first job that takes too long until the run knows it: what a process of its own tells
/// every millisecond, and up to 1 ms that an emulated job may take longer.
inline constexpr std::int64_t kNoticeUs = 3000;

/// Errors: as solve_tables; kInfeasible where no policy keeps up with a scenario, or none was found.
[[nodiscard]] Result<Tables> solve_key_tables(const AppSpec& app, const Platform& platform,
                                              const Scenarios& scenarios,
                                              const TablesOptions& options);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Few policies for many scenarios: which, and which of them serves which scenario.
//
// The regret of a policy under a scenario is its certified worst case there over the scenario's
// proven lower bound. Every table is ordered on each XPU, so its worst case under a scenario is the
// longest path at that scenario's WCETs, and holds for all that lies component-wise below it
// (order.h). Asked is the least largest regret with K tables, or the fewest tables within a regret.
//
//  1. Each scenario is solved alone: its lower bound, and a candidate.
//  2. Choice: of the candidates the K of least largest regret. For a regret r that is a set cover
//     (an ILP of a binary per candidate and a row per scenario); the r are the candidates' own.
//  3. Each chosen table is annealed for the scenarios that it serves, all of them at once: the
//     largest makespan / bound falls. What comes of it is one more candidate. Then 2 again.
//
// Where the app is small, every table of it is a candidate instead: each assignment, each order. No other
// tables are better then. Else the bounds are proven, the worst cases certified, and that is not.
//
// Where a scenario is degraded, and no policy was found there that ends a release in the time that it
// has, the app loses the least with which one was (least_loss.h); where all that it may lose does not
// suffice, all of that. Bound and regret are then those of what is left.
//
// So it is where an app releases one at a time, and a release's length says all. The answer is tables of keys, each the
// end of the longest way at its envelope (keys/sequence.h). Of all other apps it is keys/key_tables.h.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>

#include <xauto/result.h>

#include "model/tables.h"

namespace xauto::solver {

struct TablesOptions {
  int tables = 0;     ///< at most so many; 0: as many as `regret` needs
  double regret = 0;  ///< at least 1: the fewest tables of at most this regret; 0: not asked
  double time_limit_s = 60;
  std::int64_t max_evaluations = 0;  ///< of each search within; 0: no limit
  int threads = 1;
  std::uint64_t seed = 1;
  const std::atomic<bool>* stop = nullptr;
  /// Filled in if not null: whether every table was tried, so that as many others are no better.
  bool* tried_all = nullptr;
  /// From the calling thread: how many scenarios are solved, or the largest regret so far.
  std::function<void(double elapsed_s, int scenarios_solved, double worst_regret)> on_progress;
};

/// Errors: kInvalid where neither tables nor regret is asked for, or where a
/// scenario is degraded and no chain has a deadline;
/// kInfeasible if no set of `tables` tables serves all scenarios (each has lost other XPUs, or
/// loses other things), or if nothing within `regret` was found.
[[nodiscard]] Result<Tables> solve_tables(const AppSpec& app, const Platform& platform,
                                          const Scenarios& scenarios, const TablesOptions& options);

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// One release of everything, as a start for the search of keys: where all XNodes are released together, the plan of
// solver/solve.h is a policy of keys. Each key is a finish, and its order pairs are Policy::order (docs/keys.md,
// "Order"). Where releases do not meet its worst case is that policy's.
#pragma once

#include "model/policy.h"
#include "solver/keys/problem.h"
#include "solver/objectives.h"
#include "solver/solve.h"
#include "solver/until.h"

namespace xauto::solver::keys {

struct ReleasePlan {
  /// The shortest plan; then, where it is not ordered on every XPU, the shortest that is.
  std::vector<Policy> policies;
  /// Of the latest end of any chain, proven: of no policy of keys an earlier one can be certified. 0: not known.
  Tick bound = 0;
  std::string proof;  ///< SolveReport::proof
};

/// No claims are in it: whoever takes it certifies it. kUnavailable: XNodes are not all released together. Else
/// as solver::solve. `p`: of this app, without order. Of the options' objectives pins, forbids and groups count.
[[nodiscard]] Result<ReleasePlan> plan_of_one_release(const AppSpec& app, const Platform& platform,
                                                      const Problem& p, SolveOptions options);

/// "heft", "local": what a plan of one release by that method is as a policy of priorities, of which nothing is claimed.
struct Baseline {
  Policy policy;
  /// From the first start to the last end, each job at its WCET, no other release beside, transfers in no time.
  std::int64_t release_us = 0;
};
[[nodiscard]] Result<Baseline> baseline(const AppSpec& app, const Platform& platform,
                                        const SolveOptions& options);

/// The plan of one release, with priorities by period, the shortest first (rate-monotonic): an XNode counts by the slowest
/// source that it waits for. Those of one period stay as they are among themselves. It claims nothing.
[[nodiscard]] Result<Policy> fixed_priorities(const AppSpec& app, const Platform& platform,
                                              SolveOptions options);

/// As one_release_bound, by what takes microseconds.
[[nodiscard]] Tick quick_release_bound(const AppSpec& app, const Platform& platform,
                                       const Problem& p, int to, const Objectives& wishes,
                                       const Until& until);
/// No policy of keys is certified to end `to` of a release earlier after its nominal release: the solver's proof for
/// what `to` waits for by edges, alone. At least 0.
[[nodiscard]] Tick one_release_bound(const AppSpec& app, const Platform& platform, const Problem& p,
                                     int to, SolveOptions options);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Lower bounds: the worst case that no keys and holds have less of, chain by chain and together.
//
// A way's time is its work and its waits.
//   Work of the first component: the bound of one release of the ancestors of the XNode that is left by;
//   behind each sample the longest way of least WCETs; or, over the whole way at once, the longest
//   way of any assignment that no type of XPU is overloaded by (load_bound.h).
//   Waits: one start of a reader of period T serves, again and again, ceil(T / T_u) releases of a
//   source of period T_u, of which the oldest waits (ceil(T / T_u) - 1) T_u longer than the newest.
//   Into a clock that the way has not been on: a whole period of the reader, as every certificate
//   counts it. docs/keys.md has the proofs.
//
// Where an XPU does not preempt, and an XNode of the first component has to share it with one that takes
// longer than a period leaves, some release waits (theorem 12). Not all do, so no waits are added.
#pragma once

#include <vector>

#include "solver/keys/problem.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// [chain] in ticks. `most_cases`: of load_bound, for each chain.
[[nodiscard]] std::vector<Tick> lower_bounds(const Problem& problem, const AppSpec& app,
                                             const Platform& platform, const Objectives& wishes,
                                             int most_cases = 0, const Until& until = {});

/// Of all chains' worst cases / Chain::by, given the bounds of each: of the weighted sum, or of the largest of
/// those with a deadline, if there are any. One assignment has to serve them all.
[[nodiscard]] double objective_bound(const Problem& problem, const std::vector<Tick>& bounds,
                                     bool sum, int most_cases = 0, const Until& until = {});

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// A bound for large apps: the platform as one machine, for many price vectors, with heads and tails
// that know what must be done before and after.
//
// For prices Y_t >= 0, an instance of type t yields at most Y_t of value per microsecond, and XNode
// i is worth min over t of Y_t wcet_it. The platform then is one machine of rate sum over t of
// Y_t instances(t), on which i takes p_i = worth / rate. So for every set S of XNodes
//   T >= min over S of head + sum over S of p + min over S of tail,
// whose maximum over all S is Jackson's preemptive schedule (Carlier, 1982).
//
// One XNode cannot keep all instances busy. The first XNodes of S on the instances are different
// ones, and so are the last: with the m smallest heads h_1 <= ... of S, the m smallest tails
// q_1 <= ..., and the instances' shares of the rate g_1 >= g_2 >= ...,
//   T >= sum of g_k h_k + sum over S of p + sum of g_k q_k,
// as the dearest instance may begin first (Carlier 1987 has it for equal machines).
//
// Both arguments on the ancestors of i bound its start, on its descendants what is left behind it;
// they are computed in topological order, so that stages one behind the other add up.
// docs/solver.md, "Quick bounds".
#pragma once

#include <vector>

#include "solver/problem.h"
#include "solver/until.h"

namespace xauto::solver {

struct CompositeBound {
  Time bound = 0;
  std::vector<Time> heads, tails;    ///< no schedule starts i earlier / needs less after its end
  std::vector<std::int64_t> prices;  ///< those that gave `bound`
};

/// `effort` 0: heads and tails by longest paths only (microseconds at 40 XNodes); 1: all of it
/// (about 0.3 s at 1000 XNodes), or as much of it as `until` allows.
[[nodiscard]] CompositeBound composite_bound(const Problem& problem, int effort = 1,
                                             const Until& until = {});

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// Load bound: the least time along a way, over all assignments that overload no type of XPU.
//
// A way has pieces; of each its longest path counts, and the sum of all pieces is the time. For
// paths 1..K of whole ways, each taken 1/K, and prices y >= 0 of the types
//   time >= sum over i of min over t of (n_i / K + y_t / T_i) C_it  -  sum over t of y_t |t|
// with n_i the number of the K paths that visit i: the mean of K paths is at most the longest, and
// what runs on a type is at most |t| of its time. Paths and prices are found by ascent in floating
// point; the sum is then taken in integers, rounded down. Where a bound depends on who is split
// between types, one XNode after the other is fixed: the least of all cases holds.
#pragma once

#include <vector>

#include "solver/steady/problem.h"
#include "solver/until.h"

namespace xauto::solver::steady {

/// A piece of a way: from any of `from` along edges to `to`.
struct Piece {
  std::vector<int> from;
  int to = -1;
};

/// In ticks. `most_cases`: how many times an XNode is fixed at most.
[[nodiscard]] Tick load_bound(const Problem& problem, const std::vector<Piece>& pieces,
                              int most_cases, const Until& until = {});

}  // namespace xauto::solver::steady

// SPDX-License-Identifier: Apache-2.0
// Joint bound: the least of all chains' worst cases together, since all sources may release at once.
//
// Take the run in which activation 0 of every component is released at its phase, whatever the clock, and every
// job takes its WCET. XNode i cannot begin before its head, the longest way of least WCETs to it; and a chain
// ends at least its tail after i. With prices y >= 0 of the types, Y = sum of y_t |t|, all XNodes are work of
// P_i = min over t of y_t C_it for one machine of speed Y. With shares a >= 0 of the chains' weights on XNodes,
//   sum over chains of weight * worst case >= sum over i of a_i (M_i + C_i / 2 + tail_i)
// where M_i is the mean of when the machine serves i. Of all its schedules the one that always serves the
// largest a_i / P_i has the least sum of a_i M_i. A part of a chain's weight may stay on a bound that is known.
// Shares and prices are found by ascent in floating point; the sum is then taken in integers, rounded down.
// docs/keys.md, theorem 14, has the proof.
#pragma once

#include <vector>

#include "solver/keys/load_bound.h"
#include "solver/keys/problem.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// Of what a chain ends with: from when an XNode has ended to the end of the chain, at least.
struct Tail {
  int xnode = -1;
  Tick tail = 0;
};

/// How a term ends: the ancestors, in the component of its source, of where its ways leave that.
struct Ending {
  std::vector<Tail> tails;
  Tick offset = 0;  ///< of the source
};

/// Of the weighted sum of worst case / by, or of the largest of them; rounded down. 0: nothing follows.
[[nodiscard]] double joint_bound(const Problem& problem, const std::vector<Term>& terms,
                                 const std::vector<Ending>& endings, bool sum,
                                 const Until& until = {});

}  // namespace xauto::solver::keys

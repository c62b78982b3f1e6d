// SPDX-License-Identifier: Apache-2.0
// Tabu search over ordered schedules (ordered.h): the search for apps that are job shops, where
// nearly all that can be decided is the order on each XPU.
//
// A move changes a critical block, XNodes one after the other on an XPU without idling between
// them: one goes behind or before all of it, or its first or last goes inside (Balas, Vazacopoulos
// 1998, "Guided local search with shifting bottleneck"; Nowicki, Smutnicki 1996). Or a critical
// XNode goes to another XPU, where its heads and tails allow (Mastrolilli, Gambardella 2000,
// "Effective neighbourhood functions for the flexible job shop problem"). Each is estimated in the
// length of the block, the best is done. A search that finds nothing begins again between two of the
// best schedules (path relinking: Peng, Lu, Cheng 2015).
//
// Only for the makespan alone, without groups. Threads: one owner. Deterministic like anneal().
#pragma once

#include <memory>

#include "solver/search.h"

namespace xauto::solver {

class TabuSearch {
 public:
  TabuSearch(const Problem& problem, std::uint64_t seed);
  ~TabuSearch();

  /// Goes on where the last call has ended, or from `start` if it is better than all found so far,
  /// until the limits; the best of all calls. `start` is ordered.
  [[nodiscard]] Solution run(const Solution& start, const StopWhen& stop_when,
                             const SearchCallbacks& callbacks);

  [[nodiscard]] static bool serves(const Problem& problem) {
    return problem.goal.plain() && problem.groups.empty() && problem.num_xnodes <= kMost;
  }

 private:
  static constexpr int kMost = 2000;  ///< XNodes; beyond, its memory of moves is too large
  class Walk;
  std::unique_ptr<Walk> walk_;
};

}  // namespace xauto::solver

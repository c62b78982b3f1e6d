// SPDX-License-Identifier: Apache-2.0
// The methods `auto` and `search`: workers on several threads that share one incumbent and one
// bound.
//
//   search   every worker anneals: priorities, order, and both together in turn; quick bounds only
//   auto     the same, but once the search has had its first turns, one worker proves: it raises
//            the bound and enumerates what is left (exact.h)
//
// Deterministic for a given seed and number of threads when max_evaluations ends it: workers then
// neither read each other's incumbents nor the clock.
#pragma once

#include "solver/search.h"
#include "solver/solve.h"

namespace xauto::solver {

struct AutoResult {
  Solution best;     ///< least latency, of any kind; ordered where that costs nothing
  Solution ordered;  ///< least certified latency
  Time bound = 0;
  std::int64_t evaluations = 0;
};

/// `began`: from when on elapsed time and the time limit count. `starts`,
/// best first, are reported as progress before anything else begins.
[[nodiscard]] AutoResult solve_in_parallel(const Problem& problem, const SolveOptions& options,
                                           const std::vector<Solution>& starts, bool with_proof,
                                           TimePoint began);

}  // namespace xauto::solver

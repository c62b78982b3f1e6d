// SPDX-License-Identifier: Apache-2.0
// The methods `auto` and `search`: workers on several threads that share one incumbent and one
// bound.
#pragma once

#include "solver/search.h"
#include "solver/solve.h"

namespace xauto::solver {

struct AutoResult {
  Solution best;
  Time bound = 0;
  std::int64_t evaluations = 0;
};

/// `with_proof`: false for `search` (annealing only, quick bounds), true for `auto`.
[[nodiscard]] AutoResult solve_in_parallel(const Problem& problem, const SolveOptions& options,
                                           const std::vector<Solution>& starts, bool with_proof);

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// The paper's model, equations 1-6, on lp_solve, by branch and cut: of equations 4 and 5 only the windows that a
// solution violates. Every row, and how it is solved, is in docs/ilp.md.
//
// Threads: each call owns its model; lp_solve is not shared between calls.
#pragma once

#include <atomic>
#include <optional>

#include "solver/problem.h"

namespace xauto::solver {

struct IlpOptions {
  double time_limit_s = 60;
  const std::atomic<bool>* stop = nullptr;
  /// A known answer: its makespan cuts off everything longer, and what is found starts from it.
  std::optional<Decision> incumbent = std::nullopt;
  /// A lower bound known from elsewhere; 0: none.
  Time known_bound = 0;
};

struct IlpAnswer {
  std::optional<Decision> decision;  ///< as found, or the incumbent if nothing better was found
  Time makespan = 0;                 ///< of `decision`, by the simulator
  Time model_makespan = 0;           ///< what the model says it takes; 0 if it found nothing
  Time bound = 0;                    ///< no policy is shorter
  bool proven = false;               ///< makespan == bound
  bool finished = false;             ///< the model was solved to its end
  std::int64_t nodes = 0;
  std::int64_t by_lp =
      0;  ///< nodes, and what is asked at the root, that lp_solve's LPs have refuted
  std::int64_t by_ranges = 0;  ///< that needed no LP
  std::int64_t lps = 0;        ///< that lp_solve has solved
};

/// Errors: kInvalid if the model would be too large (rows are O(n^3 m)). An LP that lp_solve cannot solve refutes
/// nothing, and the search goes on: it ends at the limit, when told, or when all is proven.
[[nodiscard]] Result<IlpAnswer> solve_ilp(const Problem& problem, const IlpOptions& options = {});

}  // namespace xauto::solver

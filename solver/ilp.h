// SPDX-License-Identifier: Apache-2.0
// Mixed-integer models on lp_solve; written out row by row in docs/ilp.md.
//
//   solve_ilp          the paper's model, equations 1-6: complete, and good for tiny cases only
//   solve_ilp_compact  assignment only, with rows for what must fit between a head and a tail.
//                      No order of XNodes is in it: it gives a lower bound and a good
//                      assignment, and no schedule
//   lp_bound           the LP relaxation of the compact model: a bound in milliseconds
//
// Threads: each call owns its model; lp_solve is not shared between calls.
#pragma once

#include <atomic>
#include <optional>
#include <string>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

struct IlpOptions {
  double time_limit_s = 60;
  const std::atomic<bool>* stop = nullptr;  ///< polled by lp_solve's abort callback
  /// A known answer: its makespan cuts off everything longer, and what is found starts from it.
  std::optional<Decision> incumbent = std::nullopt;
  /// A lower bound known from elsewhere; 0: none.
  Time known_bound = 0;
  /// Longest list of head/tail rows per type (compact model).
  int max_rows_per_type = 60;
  /// If not empty, the model is written there in lp_format before it is solved (*.mps: free MPS).
  std::string write_model = {};
};

struct IlpAnswer {
  std::optional<Decision> decision;  ///< as found, or the incumbent if nothing better was found
  Time makespan = 0;                 ///< of `decision`, by the simulator
  Time model_makespan = 0;           ///< what the model says it takes; 0 if it found nothing
  Time bound = 0;                    ///< no schedule is shorter
  bool proven = false;               ///< makespan == bound
  bool finished = false;             ///< the model was solved to its end
  std::int64_t nodes = 0;
  int rows = 0, columns = 0;
  std::string
      status;  ///< "optimal", "infeasible below the incumbent", "time limit", "stopped", ...
};

/// Errors: kInvalid if the model would be too large (rows are O(n^3 m)).
[[nodiscard]] Result<IlpAnswer> solve_ilp(const Problem& problem, const IlpOptions& options = {});
[[nodiscard]] Result<IlpAnswer> solve_ilp_compact(const Problem& problem,
                                                  const IlpOptions& options = {});

/// LP relaxation of the compact model. `share`: the fraction of each XNode on each type,
/// [xnode * num_types + type].
struct LpBound {
  Time bound = 0;
  std::vector<double> share;
};
[[nodiscard]] Result<LpBound> lp_bound(const Problem& problem, const IlpOptions& options = {});

}  // namespace xauto::solver

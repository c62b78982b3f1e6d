// SPDX-License-Identifier: Apache-2.0
// The paper's model, equations 1-6, on lp_solve: complete, and good for tiny cases only. Written out row by
// row in docs/ilp.md.
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

}  // namespace xauto::solver

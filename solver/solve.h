// SPDX-License-Identifier: Apache-2.0
// The one entry to all methods: AppSpec + Platform -> PriorityPlan.
#pragma once

#include <atomic>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "solver/objectives.h"
#include "solver/problem.h"

namespace xauto::solver {

struct Progress {
  double elapsed_s = 0;
  Time incumbent = 0, bound = 0;
  Time ordered = 0;  ///< the least so far of schedules that keep an order on every XPU
  double gap = 0;    ///< (incumbent - bound) / incumbent
  double evaluations_per_s = 0;
};

struct SolveOptions {
  std::string method = "auto";  ///< auto | search | ilp | heft | local
  double time_limit_s = 10;
  int threads = 1;
  std::uint64_t seed = 1;
  std::int64_t max_evaluations =
      0;  ///< 0: no limit; with a limit the answer does not depend on speed
  /// Of what is ordered on every XPU: no execution of it takes longer than that at WCET (order.h).
  bool ordered_only = false;
  bool priorities_only = false;  ///< no run-time order
  /// Problem::let_all_nested_pay: what certificates of keys count. The bound is then of those, and may be above the
  /// latency of a policy of priorities that nothing certifies.
  bool all_nested_pay = false;
  const std::atomic<bool>* stop = nullptr;  ///< set by Ctrl-C: return the best so far
  /// Called from the solving thread: at once with the first answer, then at most 10 Hz.
  std::function<void(const Progress&)> on_progress;
  Objectives objectives;  ///< beyond the makespan; only auto and search honour chains and groups
  struct SolveReport* report = nullptr;  ///< filled in if not null
};

/// What a policy file has no place for.
struct SolveReport {
  std::int64_t evaluations = 0;
  /// Where the plan is not ordered on every XPU, the shortest found that is: its worst case is its latency.
  std::optional<PriorityPlan> ordered;
  std::string proof;  ///< method ilp: who has proven what, in words
};

/// Errors: kInvalid / kInfeasible from Problem::create; kInvalid for an unknown method, for chains
/// and groups where the method knows none, for sources of several rates. A time limit is not an
/// error: the best policy so far comes back with its bound, after at most 1.3 times the limit and a
/// second more, whatever the size; a stop takes less than a second.
[[nodiscard]] Result<PriorityPlan> solve(const AppSpec& app, const Platform& platform,
                                         const SolveOptions& options);

/// A PriorityPlan from a Decision: simulated, priorities as given, bound/optimal/worst case left to the
/// caller.
[[nodiscard]] PriorityPlan make_policy(const AppSpec& app, const Platform& platform,
                                       const Problem& problem, const Decision& decision,
                                       std::string method);

}  // namespace xauto::solver

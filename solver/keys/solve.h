// SPDX-License-Identifier: Apache-2.0
// The entry: AppSpec + Platform -> Policy with a certificate, a proof that
// there is none, or "unknown".
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "model/policy.h"
#include "solver/keys/search.h"
#include "solver/keys/sustain.h"
#include "solver/objectives.h"

namespace xauto::solver::keys {

/// What is minimised unless somebody asks otherwise: of an app that releases one at a time how long all of it takes.
[[nodiscard]] inline Aim usual_aim(const AppSpec& app) {
  return app.one_at_a_time ? Aim::kLargest : Aim::kMix;
}

struct Progress {
  double elapsed_s = 0;
  double late = 0;  ///< largest worst case / deadline; 0: no chain has a deadline
  double sum = 0;   ///< Totals::sum
  std::int64_t evaluations = 0;
  /// While a release is planned that is alone: how long its best plan takes, and no plan less. Else 0.
  std::int64_t release_us = 0, release_bound_us = 0;
  double evaluations_per_s = 0;  ///< of that
};

struct Options {
  Aim aim = Aim::kMix;
  double time_limit_s = 10;
  int threads = 1;
  std::uint64_t seed = 1;
  /// 0: no limit. With one, each thread's share of it ends it, and the answer does not depend on
  /// speed as long as the time limit does not end it first.
  std::int64_t max_evaluations = 0;
  const std::atomic<bool>* stop = nullptr;
  std::function<void(const Progress&)>
      on_progress;  ///< each improvement, from any thread, one at a time
  /// Of an app that releases one at a time also "search" and "ilp" (solver/solve.h): who plans the release. The keys of
  /// such a plan are its ends, and its order stays. HEFT and "local" have priorities: baseline() in one_release.h.
  std::string method = "auto";
  Objectives wishes;  ///< pins, forbids and groups
  bool order = true;  ///< policies may have Policy::order; tables have no place for it
  /// Where to begin; proven again before it is certified. May be of an earlier version of the app:
  /// xpu -1 for an XNode that it does not know.
  const Policy* hint = nullptr;
  Beside beside = {};  ///< others, whose claims stay, and a reserve (docs/keys.md, "Apps compose")
  Keep keep = Keep::kNothing;
  bool spread = false;  ///< app and platform are solve_on_hosts()'s: a type is of a host
};

/// Of all chains' worst cases. Where a chain has a deadline, in parts of deadlines: one that has none counts in the
/// sum as if it had the largest of the others'. Else in us.
struct Totals {
  double largest = 0;  ///< of those with a deadline, if there are any
  double sum = 0;      ///< weighted
};
[[nodiscard]] Totals totals_of(const AppSpec& app, const std::vector<std::int64_t>& chain_us);

enum class Outcome {
  kPolicy,
  kUnsustainable,  ///< proven: no policy keeps up
  kUnknown,        ///< neither a policy nor a proof within the limits
};

struct Answer {
  Outcome outcome = Outcome::kUnknown;
  Policy policy;           ///< kPolicy
  OverloadProof overload;  ///< kUnsustainable
  /// [chain] where no policy was found, too.
  std::vector<std::int64_t> lower_bound_us;
  /// kPolicy: of the policy's chains. No policy has less of either than the bounds, which are at least what
  /// lower_bound_us say.
  Totals totals, bounds;
  double least_largest = 0;  ///< kPolicy: that was found, of any policy
  std::vector<int> moved;    ///< XNodes that are not where the hint has them
  std::string proof;         ///< method ilp: who has proven what of the release, in words
  double first_answer_ms = 0;
  std::int64_t evaluations = 0;
};

/// kInvalid, kInfeasible: Problem::create; a hint for another app.
[[nodiscard]] Result<Answer> solve(const AppSpec& app, const Platform& platform,
                                   const Options& options);

}  // namespace xauto::solver::keys

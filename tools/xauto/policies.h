// SPDX-License-Identifier: Apache-2.0
// What solve, explain, check and simulate do with one policy.
#pragma once

#include <string>
#include <vector>

#include "solver/keys/play.h"
#include "solver/keys/solve.h"

#include "xauto/apps.h"
#include "xauto/command.h"

namespace xauto::cli {

/// Where the answer goes.
struct SolveOut {
  std::vector<std::string> policies;  ///< one for each app, or none
  std::string demand;                 ///< demand.json, if there is a name
};
/// `asked.wishes` are filled in. Status 1: a deadline is missed, or nothing is certified: then the policy is the best
/// that was found, without claims; beside others, or with a reserve, there is none.
/// `assume`: changes whose effect is told (solver/keys/what_if.h).
[[nodiscard]] Result<int> solve_policy(const Apps& apps, const Platform& platform,
                                       const solver::keys::Options& asked,
                                       const std::vector<std::string>& assume, const SolveOut& out,
                                       const Options& options);
/// The tightest windows, the worst path of each chain, and what moving its XNodes would bring, as far
/// as that is found within `moves_s`. A picture of all windows goes to `picture`, if there is one.
[[nodiscard]] Result<int> explain_policy(const AppSpec& app, const Platform& platform,
                                         const std::string& policy, const std::string& picture,
                                         double moves_s, const Options& options);
/// Status 1: a policy claims what does not follow, beside `others` too, misses a deadline, or breaks what is `asked`.
/// `demand`: where demand.json goes, if there is a name.
[[nodiscard]] Result<int> check_policy(const Apps& apps, const Platform& platform,
                                       const std::vector<std::string>& policies,
                                       const solver::Objectives& asked, const BesideFlags& others,
                                       const std::string& demand, const Options& options);
[[nodiscard]] Result<int> simulate_policy(const Apps& apps, const Platform& platform,
                                          const std::vector<std::string>& policies,
                                          const solver::keys::PlayOptions& asked,
                                          const std::string& out, const Options& options);

}  // namespace xauto::cli

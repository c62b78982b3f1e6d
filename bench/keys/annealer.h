// SPDX-License-Identifier: Apache-2.0
// A plain annealer, to compare with: assignment, and an order of each XPU's jobs. It simulates each
// clock by itself until a hyperperiod repeats, takes the ends for keys, and has `xauto check`'s code
// say whether they hold and what the chains' worst cases are. No holds, no bounds, one thread. It
// shares nothing with the solver.
#pragma once

#include <cstdint>
#include <optional>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/keys/solve.h"

namespace xauto::bench {

struct Annealed {
  std::optional<Policy> policy;  ///< its claims are what the check derives
  double first_ms = 0;
  std::int64_t evaluations = 0;
};

/// Of a valid app that the platform can run.
[[nodiscard]] Annealed anneal(const AppSpec& app, const Platform& platform, double time_limit_s,
                              std::uint64_t seed);

/// What it minimises: the largest worst case / deadline, where a chain has a deadline; else the weighted sum, in us.
[[nodiscard]] double objective_of(const AppSpec& app, const std::vector<std::int64_t>& chain_us);
[[nodiscard]] double objective_of(const AppSpec& app, const Policy& policy);

}  // namespace xauto::bench

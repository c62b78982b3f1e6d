// SPDX-License-Identifier: Apache-2.0
// PriorityPlan: one release of all XNodes by priorities: what the one-release solver finds, what a Policy is written
// from (model/policy.h), and what ranks threads.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"

namespace xauto {

/// Where one XNode runs and how urgent it is. Priority: larger is more urgent, everywhere in XAuto.
struct PriorityPlacement {
  int xpu = -1;               ///< index into Platform::xpus
  std::int64_t priority = 0;  ///< unique per XPU instance
  std::int64_t start_us = 0;  ///< predicted, every job at its WCET, all sources released at 0
  std::int64_t finish_us = 0;
  bool operator==(const PriorityPlacement&) const = default;
};

struct PriorityPlan {
  std::string app;                            ///< AppSpec::name
  std::string app_hash;                       ///< AppSpec::hash()
  std::string platform;                       ///< Platform::name, for people
  std::string method;                         ///< "ilp", "search", "heft", "local", "auto"
  std::vector<PriorityPlacement> placements;  ///< one per AppSpec::xnodes entry, same order
  /// Run-time order constraints (u, v) between XNodes of one XPU: v is not started before u has
  /// finished, even when the XPU is idle. They remove timing anomalies (solver/order.h).
  std::vector<std::pair<int, int>> order;
  std::int64_t latency_us = 0;  ///< makespan of the predicted schedule, with `order` enforced
  /// Proven: no PriorityPlan for this app and platform is shorter; or, with solver::SolveOptions::all_nested_pay, none
  /// by that rule.
  std::int64_t lower_bound_us = 0;
  bool optimal = false;  ///< proven: latency_us == lower_bound_us
  std::int64_t solve_us = 0;
  bool operator==(const PriorityPlan&) const = default;
};

/// Order pairs: of XNodes that are there, on one XPU (`xpu_of`), each once, without a cycle with the edges.
[[nodiscard]] Status validate_order(const std::vector<std::pair<int, int>>& order,
                                    const std::vector<int>& xpu_of, const AppSpec& app);

}  // namespace xauto

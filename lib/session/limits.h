// SPDX-License-Identifier: Apache-2.0
// What a job may take: its budget, when it counts as hung, and the WCET that claims rest on. runtime/stopwatch.h says
// what is timed.
#pragma once

#include <cstdint>
#include <string>

#include "model/deployment.h"

namespace xauto::runtime {

/// What the jobs of one XNode may take; 0: no limit.
struct Limits {
  std::int64_t budget_ns = 0, hang_ns = 0;
  /// The policy claims worst cases of jobs that take no longer. With tables: in each scenario that the
  /// table serves; of longer ones the scenario in force decides (tables/table_switch.h).
  std::int64_t wcet_ns = 0;
  /// How long a job takes decides which table is next: no scenario is in doubt before it takes this, so nobody asks.
  std::int64_t tell_ns = 0;
  OnHang on_hang = OnHang::kLog;
  [[nodiscard]] bool any() const { return budget_ns > 0 || hang_ns > 0 || wcet_ns > 0; }

  /// Of an XNode whose WCET on its XPU is `wcet_us`.
  [[nodiscard]] static Limits of(const Deployment& deployment, const std::string& module,
                                 const std::string& xnode, std::int64_t wcet_us);
};

}  // namespace xauto::runtime

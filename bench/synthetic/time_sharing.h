// SPDX-License-Identifier: Apache-2.0
// What happens when nobody schedules: CPUs share fairly, everything else takes turns.
#pragma once

#include "model/platform.h"
#include "solver/simulate.h"

namespace xauto::bench {

enum class Sharing {
  kRos2,       ///< each stage on its fastest XPU type; CPUs shared fairly, others round-robin
  kTimeshare,  ///< the policy's assignment without scheduling: every instance time-shares
};

struct SharingOptions {
  bool slices = false;  ///< they overlap where XNodes share
  bool ideal = false;   ///< without time slices or switch cost, whatever the platform says
};

/// kRos2 (decision ignored) and kTimeshare. CPU-type XPUs: ideal processor sharing (a job never
/// gets more than one core); in kRos2 the cores are one pool, in kTimeshare each core is shared by
/// the XNodes assigned to it. Every other XPU: round-robin by timeslice_us, effective_switch_us at
/// each change of context, in order of arrival; timeslice_us = 0: ideal sharing. kRos2 with several
/// instances of a type: an arriving XNode joins the instance with the fewest XNodes at that moment
/// (lowest index first). Its pool is Simulation::xpu's first CPU.
[[nodiscard]] solver::Simulation share_time(const solver::Problem& problem,
                                            const Platform& platform, Sharing sharing,
                                            const solver::Decision& decision,
                                            const SharingOptions& options = {});

}  // namespace xauto::bench

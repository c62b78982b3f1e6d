// SPDX-License-Identifier: Apache-2.0
// A policy on the emulated XPUs (emu::Machine), each under the coordinator's own decisions
// (coord::Arbiter), in virtual time. Neither shares code with solver/simulate.cc.
#pragma once

#include <cstdint>

#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"

namespace xauto::bench {

struct Emulated {
  std::vector<std::int64_t> finish_us;  ///< [xnode], rounded up
  std::int64_t latency_us = 0;
};

/// kUnavailable: an XPU has more XNodes than a coordinator has slots.
[[nodiscard]] Result<Emulated> emulate(const AppSpec& app, const Platform& platform,
                                       const PriorityPlan& policy);

}  // namespace xauto::bench

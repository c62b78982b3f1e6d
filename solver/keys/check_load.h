// SPDX-License-Identifier: Apache-2.0
// Per XPU, alone: whatever arrives within its windows ends within them. Used by check.cc.
#pragma once

#include <xauto/result.h>

#include "solver/keys/check.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys::checking {

/// The proof for XPU `m`, or why there is none. The world's ticks are a multiple of those of `beside`.
[[nodiscard]] Result<XpuProof> prove_load(const World& w, int m, const Beside& beside);
/// The same of demands alone. Their XPU has the id of `xpu`; `ticks_per_us`: a multiple of theirs.
[[nodiscard]] Result<XpuProof> prove_together(const Xpu& xpu, std::int64_t ticks_per_us,
                                              const Beside& all);
/// What it has of the policy, for others to test; no sequences: nothing.
[[nodiscard]] DemandOnXpu demand_on(const World& w, int m);

}  // namespace xauto::solver::keys::checking

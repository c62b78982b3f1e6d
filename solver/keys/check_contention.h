// SPDX-License-Identifier: Apache-2.0
// Beside whom may an XNode run, by the windows of a World, and what does it then take? Used by check*.cc alone.
#pragma once

#include "model/contention.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys::checking {

/// [xnode] the XPUs on which jobs may run while it does, of the types that it states on the type of its own; empty where it
/// states none. Read of `w`: windows, and who waits for whom.
[[nodiscard]] std::vector<Load> loads_met(const World& w);
/// kInfeasible: the policy counts less for an XNode than it takes beside what it meets. `others`: other apps may be on
/// every XPU at any time.
[[nodiscard]] Status prove_counted(const World& w, bool others);

}  // namespace xauto::solver::keys::checking

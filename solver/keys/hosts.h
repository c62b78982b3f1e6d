// SPDX-License-Identifier: Apache-2.0
// An app over several computers (docs/keys.md, "Hosts"). To the solver a type of XPU on a host is a type of its own,
// "gpu@front", and a message between hosts a transfer between types. WCETs, and clocks but "main", are as a host's clock
// reads them.
//
// How long a message takes depends on what else crosses, so on the hosts of all modules. First all may be anywhere, and
// each message has its link alone: no policy is better, so bounds are of that. Then hosts of modules are tried, each with
// what really crosses: those of that answer, each host for all, and from the best one module after the other elsewhere.
// Threads: as solve.h.
#pragma once

#include "solver/keys/solve.h"

namespace xauto::solver::keys {

/// kInvalid: sources without a rate, others beside it, a pin to a host that is not there. kInfeasible: nowhere may
/// modules be with links between them that are fast enough.
[[nodiscard]] Result<Answer> solve_on_hosts(const AppSpec& app, const Platform& platform,
                                            const Options& options);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Holds: which of a certified policy's are needed. The search holds every job that may interrupt, block or read at
// its planned start; that buys a worst case here and there, and costs every job its average latency.
//
// Keys stay as they are. A hold goes if without it every XPU still has its certificate, and no chain's claim
// grows that anybody asks for. Then those that are left are shortened.
#pragma once

#include <vector>

#include "solver/keys/problem.h"
#include "solver/keys/windows.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// `w` is certified; it stays so. Until nothing more can go, or `until` is over.
void drop_holds(const Problem& problem, const std::vector<int>& xpu, Windows& w,
                const Until& until = {});

}  // namespace xauto::solver::keys

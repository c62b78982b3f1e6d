// SPDX-License-Identifier: Apache-2.0
// Contention: which XPUs an XNode may run beside, by windows, and what it then takes (docs/keys.md, "Contention").
#pragma once

#include <vector>

#include "solver/keys/problem.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

/// [xnode] its WCET on its XPU beside whatever may run while it does. Read of `w`: d and e. Where loads are stated of no
/// XNode, and beside other apps: Problem::wcet.
[[nodiscard]] std::vector<Tick> counted_wcets(const Problem& problem, const std::vector<int>& xpu,
                                              const Windows& w);
/// The problem with these as its WCETs there.
void count_wcets(Problem& problem, const std::vector<int>& xpu, const std::vector<Tick>& counted);
/// [xnode] alone; beside the most that is stated.
[[nodiscard]] std::vector<Tick> least_counted(const Problem& problem, const std::vector<int>& xpu);
[[nodiscard]] std::vector<Tick> most_counted(const Problem& problem, const std::vector<int>& xpu);

}  // namespace xauto::solver::keys

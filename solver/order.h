// SPDX-License-Identifier: Apache-2.0
// Run-time order of plans. Fixed priorities alone have timing anomalies: a job that ends early may lengthen the whole.
// Where all XNodes of each XPU are ordered, every start is a maximum of finishes and every finish a start plus a time:
// no execution is longer than that at WCET. What has no order is certified as keys (keys/certificate.h).
#pragma once

#include <utility>
#include <vector>

#include "solver/search.h"

namespace xauto::solver {

/// The order pairs of an ordered solution, transitively reduced: a pair that already follows from
/// the edges and the other pairs is left out.
[[nodiscard]] std::vector<std::pair<int, int>> order_pairs(const Problem& problem,
                                                           const Solution& solution,
                                                           const Until& until = {});

/// [xpu] Whether somebody starts on it while another one has not ended. `xpu`, `start`, `finish`: [xnode].
[[nodiscard]] std::vector<char> where_some_suspend(int num_xpus, const std::vector<int>& xpu,
                                                   const std::vector<Time>& start,
                                                   const std::vector<Time>& finish);

/// The decision with the order of its own schedule on every XPU on which that suspends nobody: at
/// WCET nothing changes.
[[nodiscard]] Decision order_undisturbed(const Problem& problem, const Decision& decision);

}  // namespace xauto::solver

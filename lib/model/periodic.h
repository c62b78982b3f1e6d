// SPDX-License-Identifier: Apache-2.0
// Of an app: clocks, modules, samples, chains, transfers.
#pragma once

#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// Every source to every XNode without successors that hears of it, by edges and samples. At most
/// kMaxAppChains + 1.
[[nodiscard]] std::vector<ChainSpec> default_chains(const AppSpec& app);

/// Fills in what a file may leave out: the modules that XNodes name, in the order of the XNodes,
/// and the chains, where there are none. Of an app that is otherwise valid.
void complete_modules(AppSpec& app);
void complete_chains(AppSpec& app);

/// AppSpec::deadline_us to each chain that has none.
void give_deadlines(AppSpec& app);

/// Of an app whose sources, XNodes and edges are valid:
///   sources   offset in [0, period), jitter from 0 to an hour; clocks with names, ppm in range;
///             urgent: by at most the period, every at least it; one such source per component
///   XNodes    without predecessors hear of a source; components as find_components() says
///   modules   each that an XNode names, once; max_in_flight from 1
///   samples   between XNodes, each once; inside a component back to an XNode that precedes it only
///   chains    at least one, connected by edges and samples without a component twice
///   transfers along edges, between types that both ends have
[[nodiscard]] Status validate_periodic(const AppSpec& app);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Constructive starts for large apps: list schedules that pay for the types they use.
//
// Earliest finish alone puts everything on the fastest XPUs until they are the bottleneck. Here a
// type costs the price that the load bound gives it (composite.h), times a weight that is tried
// from "none" to "price decides"; XNodes are taken by longest tail, either as soon as the graph
// allows or as soon as time does. Which weight is best varies from app to app, so the search gets
// them all.
#pragma once

#include <vector>

#include "solver/composite.h"
#include "solver/search.h"

namespace xauto::solver {

/// The most promising for a long search first; evaluated under fixed priorities. At least one, and
/// all of them unless `until` ends it.
[[nodiscard]] std::vector<Solution> priced_solutions(const Problem& problem,
                                                     const CompositeBound& composite,
                                                     const Until& until = {});

}  // namespace xauto::solver

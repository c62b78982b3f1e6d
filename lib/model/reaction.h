// SPDX-License-Identifier: Apache-2.0
// Reaction times of an app that ran, whoever ran it: the same rule for a trace and for a simulation.
#pragma once

#include <cstdint>
#include <vector>

#include "model/app.h"

namespace xauto {

/// An activation that ran, of a program in which one message or one release fires each.
struct RanJob {
  int xnode = -1;
  std::int64_t start_ns = 0, end_ns = 0;
  std::int64_t release = -1;  ///< of `source`: which release fired it; -1: a message did
  int source = -1;            ///< index into AppSpec::sources
  std::int64_t from = -1;     ///< which job's message fired it; -1: a release did, or nobody knows
};

/// [chain] reaction times in ns, a release each, in their order: from the nominal release to the end of the first job of
/// the chain's XNode that knows it, or a newer one. A job knows what fired it, and of each sample what the newest
/// finished job of its writer knew when it began. Releases before the first known one, and after the last, have none.
/// `releases`: [source] nominal instants in ns. `jobs` are in the order of their starts.
[[nodiscard]] std::vector<std::vector<std::int64_t>> reaction_times(
    const AppSpec& app, const std::vector<RanJob>& jobs,
    const std::vector<std::vector<std::int64_t>>& releases);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// What a user may ask for beyond the least makespan: deadlines per chain, pinning,
// forbidding and grouping of XNodes. Everything is named by name, as in app.json ("chains", "pins",
// "forbids", "groups") and on the command line; resolve() turns it into the dense form that the
// search reads.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

/// From a sensor's XNode to an output's. All sources are released at 0, so its latency is the
/// finish of `to`.
struct ChainWish {
  std::string name, from, to;
  std::optional<Time> deadline_us;
};

struct Objectives {
  std::vector<ChainWish> chains;
  std::vector<std::pair<std::string, std::string>> pins;     ///< XNode -> XPU id or type
  std::vector<std::pair<std::string, std::string>> forbids;  ///< XNode -> XPU id or type
  std::vector<std::vector<std::string>> groups;              ///< XNodes on one instance

  [[nodiscard]] bool empty() const {
    return chains.empty() && pins.empty() && forbids.empty() && groups.empty();
  }
};

/// Narrows `problem` and fills its goal. kInvalid: an unknown name, a chain that does not connect;
/// kInfeasible: an XNode or a group that has no XPU left.
[[nodiscard]] Status resolve(const Objectives& objectives, const AppSpec& app,
                             const Platform& platform, Problem& problem);

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// An app as a picture: sources, XModules, XNodes, what fires whom, what is sampled, how often, and
// with a policy on which XPU of which host, and what crosses between them. For `xauto graph`. Pure.
#pragma once

#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::story {

/// Where each XNode runs.
struct GraphPlaces {
  const Platform* platform = nullptr;  ///< null: not known
  std::vector<int> xpu;                ///< [xnode] index into the platform's XPUs
  std::vector<Crossing> crossings = {};
  /// Of an XNode; -1: hosts are not known, or there are none.
  [[nodiscard]] int host(int xnode) const {
    if (platform == nullptr || platform->hosts.empty()) return -1;
    return platform->xpus[static_cast<std::size_t>(xpu[static_cast<std::size_t>(xnode)])].host;
  }
  /// "X 0.7 ms" of a message from `u` to `v`; empty: both are on one host.
  [[nodiscard]] std::string crossing(int u, int v) const;
};

/// All of it, for Graphviz. As long as the app.
[[nodiscard]] std::string graph_dot(const AppSpec& app, const GraphPlaces& places);

/// One SVG that needs no other program: a band for each host, clock and rate, a column for each step from
/// the source on. At most kMostDrawn XNodes and kMostLines arrows; it says what is left out.
[[nodiscard]] std::string graph_svg(const AppSpec& app, const GraphPlaces& places);

inline constexpr std::size_t kMostDrawn = 400, kMostLines = 4000;

}  // namespace xauto::story

// SPDX-License-Identifier: Apache-2.0
// An app as a picture: sources, XModules, XNodes, what fires whom, what is sampled, how often, and
// with a policy on which XPU. For `xauto graph`. Pure.
#pragma once

#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"

namespace xauto::story {

/// Where each XNode runs.
struct GraphPlaces {
  const Platform* platform = nullptr;  ///< null: not known
  std::vector<int> xpu;                ///< [xnode] index into the platform's XPUs
};

/// All of it, for Graphviz. As long as the app.
[[nodiscard]] std::string graph_dot(const AppSpec& app, const GraphPlaces& places);

/// One SVG that needs no other program: a band for each clock and rate, a column for each step from
/// the source on. At most kMostDrawn XNodes and kMostLines arrows; it says what is left out.
[[nodiscard]] std::string graph_svg(const AppSpec& app, const GraphPlaces& places);

inline constexpr std::size_t kMostDrawn = 400, kMostLines = 4000;

}  // namespace xauto::story

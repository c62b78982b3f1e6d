// SPDX-License-Identifier: Apache-2.0
// A picture of a policy of keys: for each XPU and XNode the windows of its jobs, from ready to key,
// and what the plan does in them. One SVG, for pages and for `xauto explain --windows`.
#pragma once

#include <string>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/keys/check.h"

namespace xauto::cli {

/// A panel per clock, since between clocks nothing is at a fixed time: one hyperperiod of it, or as
/// much as `kMostWindows` jobs. `report`: of this policy.
[[nodiscard]] std::string windows_svg(const AppSpec& app, const Platform& platform,
                                      const Policy& policy,
                                      const solver::keys::CheckReport& report);

inline constexpr std::int64_t kMostWindows = 600;

}  // namespace xauto::cli

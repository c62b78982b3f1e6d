// SPDX-License-Identifier: Apache-2.0
// A ROS 2 program that was traced, as an app. docs/import.md says what is exact in it, and what is not.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

#include "import/architecture.h"
#include "import/ros2_trace.h"

namespace xauto::import {

struct Ros2Options {
  std::string name;             ///< of the app
  std::string from;             ///< Seen::from
  std::int64_t margin_pct = 0;  ///< WCET: the longest time that was seen, and so much more
};

/// `architecture`: empty where there is none. `lines`: for people, what was made of the trace and what was left out.
[[nodiscard]] Result<ImportedApp> ros2_app(const RosTrace& trace, const Architecture& architecture,
                                           const Ros2Options& options,
                                           std::vector<std::string>& lines);

}  // namespace xauto::import

// SPDX-License-Identifier: Apache-2.0
// Several policies for several scenarios: `xauto solve --scenarios`, and `xauto check` of what that
// writes.
#pragma once

#include <string>

#include "model/app.h"
#include "model/platform.h"
#include "solver/tables.h"

#include "xauto/command.h"

namespace xauto::cli {

/// Solves, prints, and writes tables.json to `out` unless that is empty. Exit status 1: a chain misses its deadline
/// in a scenario, or while one takes the place of another.
[[nodiscard]] Result<int> solve_with_tables(const AppSpec& app, const Platform& platform,
                                            const std::string& scenarios,
                                            solver::TablesOptions asked, const std::string& out,
                                            const Options& options);

[[nodiscard]] Result<int> check_tables(const AppSpec& app, const Platform& platform,
                                       const std::string& path, const Options& options);

}  // namespace xauto::cli

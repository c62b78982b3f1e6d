// SPDX-License-Identifier: Apache-2.0
// What `check` and `simulate` do for an app of version 2: sources that release on and on.
#pragma once

#include <string>

#include "model/app.h"
#include "model/platform.h"
#include "solver/objectives.h"
#include "solver/steady/play.h"

#include "xauto/command.h"

namespace xauto::cli {

/// Prints the proof of each XPU and each chain. kAnswerIsNo where the policy claims what does not
/// follow, breaks a pin, or misses a deadline.
[[nodiscard]] Result<int> check_periodic(const AppSpec& app, const Platform& platform,
                                         const std::string& policy_path,
                                         const solver::Objectives& asked, const Options& options);

/// Prints what happened. kAnswerIsNo where a job was late or a chain took longer than its claim.
/// `out`: a file for the JSON, or empty.
[[nodiscard]] Result<int> play_periodic(const AppSpec& app, const Platform& platform,
                                        const std::string& policy_path,
                                        const solver::steady::PlayOptions& play,
                                        const std::string& out, const Options& options);

}  // namespace xauto::cli

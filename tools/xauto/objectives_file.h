// SPDX-License-Identifier: Apache-2.0
// The optional keys of app.json that only the solver reads: "chains", "pins", "forbids", "groups"
// (docs/formats.md). They change what is asked for, not what the app is, so they are not in its
// hash.
#pragma once

#include <string>

#include <xauto/result.h>

#include "solver/objectives.h"

namespace xauto::cli {

[[nodiscard]] Result<solver::Objectives> load_objectives(const std::string& app_path);
/// "xnode=target" of a command line option.
[[nodiscard]] Result<std::pair<std::string, std::string>> parse_assignment(
    const std::string& text, const std::string& option);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// The optional keys of app.json that only the solver reads: "pins", "forbids", "groups"
// (docs/formats.md). They change what is asked for, not what the app is, so they are not in its
// hash.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "cli/cli.h"
#include "solver/objectives.h"

namespace xauto::cli {

[[nodiscard]] Result<solver::Objectives> load_objectives(const std::string& app_path);
/// The same of a text; `origin` is named in errors. Not JSON or no object: none.
[[nodiscard]] Result<solver::Objectives> parse_objectives(const std::string& text,
                                                          const std::string& origin);

/// What the command line asks for on top.
struct Wishes {
  std::vector<std::string> pins, forbids, groups;
  [[nodiscard]] bool given() const { return !pins.empty() || !forbids.empty() || !groups.empty(); }
};
void add_wishes(Verb verb, Wishes& wishes);
[[nodiscard]] Status add_to_objectives(const Wishes& wishes, solver::Objectives& objectives);
/// "xnode=target" of a command line option.
[[nodiscard]] Result<std::pair<std::string, std::string>> parse_assignment(
    const std::string& text, const std::string& option);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// TODOs that no trace and no model answers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "model/imported.h"

namespace xauto::import {

inline constexpr std::size_t kMostAsked = 8;  ///< questions of one kind

/// "1 XNode", "2 XNodes"
[[nodiscard]] std::string counted(std::size_t count, const char* what);
/// `name` without leading slashes, at most 120 bytes of it; "unnamed" where that is no name.
[[nodiscard]] std::string bare(const std::string& name);
/// ns as us, rounded up.
[[nodiscard]] std::int64_t up_to_us(std::int64_t ns);
/// `us` and `margin_pct` percent more, as a WCET may be.
[[nodiscard]] std::int64_t with_margin(std::int64_t us, std::int64_t margin_pct);

/// That what an importer has made is an app. The error begins with `made`, and is at `where`, if that is said.
[[nodiscard]] Status is_app(const AppSpec& app, const char* made, const std::string& where = {});

/// At most kMaxTodo. `at`: as Todo::at.
void todo(ImportedApp& imported, std::string at, const std::string& what);
/// Each chain's deadline, or that of all.
void ask_deadlines(ImportedApp& imported);
/// Jitter of those sources that are of clocks of their own.
void ask_jitters(ImportedApp& imported);
/// Where else the XNodes could run that take most: `load`, [xnode], in any unit.
void ask_other_xpus(ImportedApp& imported, const std::vector<double>& load);

}  // namespace xauto::import

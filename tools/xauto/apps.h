// SPDX-License-Identifier: Apache-2.0
// What --app names: one app, or several that are planned, checked and played as one (model/together.h).
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "cli/cli.h"
#include "model/app.h"
#include "model/demand.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/objectives.h"

namespace xauto::cli {

struct Apps {
  std::vector<AppSpec> each;  ///< in the order of --app
  AppSpec all;                ///< of one it is that one
  [[nodiscard]] bool several() const { return each.size() > 1; }
};

[[nodiscard]] Result<Apps> load_apps(const std::vector<std::string>& paths);

/// One file of `option` for each app, or none at all.
[[nodiscard]] Status one_for_each(const Apps& apps, const std::vector<std::string>& paths,
                                  const std::string& option);

/// As load_platform_of (model/json.h); kInvalid also: the policies name several.
[[nodiscard]] Result<Platform> load_platform_of_all(const std::vector<std::string>& policies,
                                                    const std::string& name_or_path);
/// One policy for each app, as one of `apps.all`.
[[nodiscard]] Result<Policy> load_policies(const Apps& apps, const std::vector<std::string>& paths,
                                           const Platform& platform);
/// What their files ask for, by the names that XNodes have in `apps.all`.
[[nodiscard]] Result<solver::Objectives> load_objectives_of(const Apps& apps,
                                                            const std::vector<std::string>& paths);

/// --beside and --reserve.
struct BesideFlags {
  std::vector<std::string> demands;
  int reserve_pct = 0;
  [[nodiscard]] bool given() const { return !demands.empty() || reserve_pct > 0; }
};
void add_beside(Verb verb, BesideFlags& flags);
[[nodiscard]] Result<Beside> load_beside(const BesideFlags& flags, const Platform& platform);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
#include "xauto/apps.h"

#include <utility>

#include <fmt/format.h>

#include "model/json.h"
#include "model/together.h"

#include "xauto/objectives_file.h"

namespace xauto::cli {

Result<Apps> load_apps(const std::vector<std::string>& paths) {
  Apps apps;
  for (const std::string& path : paths) {
    XAUTO_ASSIGN(AppSpec app, load_app(path));
    apps.each.push_back(std::move(app));
  }
  XAUTO_ASSIGN(apps.all, merge_apps(apps.each));
  return apps;
}

Status one_for_each(const Apps& apps, const std::vector<std::string>& paths,
                    const std::string& option) {
  if (paths.empty() || paths.size() == apps.each.size()) return {};
  return fail(ErrorCode::kInvalid,
              fmt::format("{} files for {} apps", paths.size(), apps.each.size()), option,
              "give one for each --app, in the same order");
}

Result<Platform> load_platform_of_all(const std::vector<std::string>& policies,
                                      const std::string& name_or_path) {
  XAUTO_ASSIGN(Platform platform, load_platform_of(policies.front(), name_or_path));
  for (const std::string& policy : policies) {
    XAUTO_ASSIGN(const Platform other, load_platform_of(policy, name_or_path));
    if (!(other == platform))
      return fail(ErrorCode::kInvalid,
                  fmt::format("is for platform '{}', {} for '{}'", other.name, policies.front(),
                              platform.name),
                  policy, "solve them for one platform");
  }
  return platform;
}

Result<Policy> load_policies(const Apps& apps, const std::vector<std::string>& paths,
                             const Platform& platform) {
  XAUTO_TRY(one_for_each(apps, paths, "--policy"));
  std::vector<Policy> policies;
  for (std::size_t a = 0; a < paths.size(); ++a) {
    XAUTO_ASSIGN(Policy policy, load_policy(paths[a], apps.each[a], platform));
    policies.push_back(std::move(policy));
  }
  return merge_policies(apps.each, apps.all, policies);
}

Result<solver::Objectives> load_objectives_of(const Apps& apps,
                                              const std::vector<std::string>& paths) {
  solver::Objectives all;
  for (std::size_t a = 0; a < paths.size(); ++a) {
    XAUTO_ASSIGN(solver::Objectives own, load_objectives(paths[a]));
    if (!apps.several()) return own;
    const auto renamed = [&](std::string& name) { name = name_together(apps.each[a].name, name); };
    for (auto& pin : own.pins) renamed(pin.first);
    for (auto& forbid : own.forbids) renamed(forbid.first);
    for (auto& group : own.groups)
      for (std::string& name : group) renamed(name);
    all.pins.insert(all.pins.end(), own.pins.begin(), own.pins.end());
    all.forbids.insert(all.forbids.end(), own.forbids.begin(), own.forbids.end());
    all.groups.insert(all.groups.end(), own.groups.begin(), own.groups.end());
  }
  return all;
}

void add_beside(Verb verb, BesideFlags& flags) {
  verb.option("--beside", flags.demands,
              "demand.json of other apps on these XPUs, whose claims stay");
  verb.option("--reserve", flags.reserve_pct,
              "so many percent of each XPU, and a preemption of each job, are for others")
      .range(1, kMaxReservePct);
}

Result<Beside> load_beside(const BesideFlags& flags, const Platform& platform) {
  Beside beside;
  beside.reserve_pct = flags.reserve_pct;
  for (const std::string& path : flags.demands) {
    XAUTO_ASSIGN(Demand demand, load_demand(path, platform));
    beside.demands.push_back(std::move(demand));
  }
  return beside;
}

}  // namespace xauto::cli

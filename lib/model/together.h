// SPDX-License-Identifier: Apache-2.0
// Several apps on one machine, as one app in memory: each keeps its clocks, and none hears another
// (docs/keys.md, "Apps compose"). Names are "app/name"; nothing of this is written to a file.
// Threads: pure.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto {

inline constexpr std::size_t kMaxTogether = 64;

/// "app/name": how an XNode, a source, a clock, a module or a chain of one of several apps is called.
[[nodiscard]] std::string name_together(const std::string& app, const std::string& name);

/// XNodes, sources, chains, ... of the first app, then of the next one. kInvalid: two apps have one name; one of
/// several has sources without a rate: it releases as soon as it can, so no demand bounds it. Of several the longest WCETs
/// count, whatever they state beside loads.
[[nodiscard]] Result<AppSpec> merge_apps(const std::vector<AppSpec>& apps);

/// [xnode of merge_apps] index into `apps`.
[[nodiscard]] std::vector<int> apps_of_xnodes(const std::vector<AppSpec>& apps);

/// Of `merged`, from one policy per app. kInvalid: one of several is not certified.
[[nodiscard]] Result<Policy> merge_policies(const std::vector<AppSpec>& apps, const AppSpec& merged,
                                            const std::vector<Policy>& policies);

/// The other way: [app] what `policy`, of `merged`, says of its XNodes and chains.
[[nodiscard]] std::vector<Policy> split_policy(const std::vector<AppSpec>& apps,
                                               const Platform& platform, const Policy& policy);

}  // namespace xauto

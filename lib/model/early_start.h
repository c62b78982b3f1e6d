// SPDX-License-Identifier: Apache-2.0
// Early start: from when on a job may run that the plan holds, at the latest. Whoever runs a policy of keys lets a job
// wait until then, or until the reason for its hold has gone: docs/keys.md, "Early start".
#pragma once

#include <cstdint>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto {

/// [xnode][activation mod size] E, in us after the nominal release: the largest of the job's hold, of its sources'
/// offsets, and of E + transfer of what it waits for, by edges and order. Empty: no hold delays it, its own or
/// another's, so that it has no need to wait. The policy is one that validate() takes.
struct PlannedStarts {
  std::vector<std::vector<std::int64_t>> ordinary;
  /// Of urgent releases: holds of what hears of the source by edges are earlier by its by_us, at most to the release.
  /// Of other XNodes as `ordinary`.
  std::vector<std::vector<std::int64_t>> urgent;
};
[[nodiscard]] PlannedStarts planned_starts_us(const AppSpec& app, const Platform& platform,
                                              const Policy& policy);

/// [xnode] The others, on other XPUs and of its clock, that it has to wait for where it starts early: the policy counts
/// less for one of the two than it takes beside the other (Placement::wcet_us), since their windows keep them apart.
[[nodiscard]] std::vector<std::vector<int>> kept_apart(const AppSpec& app, const Platform& platform,
                                                       const Policy& policy);

}  // namespace xauto

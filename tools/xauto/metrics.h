// SPDX-License-Identifier: Apache-2.0
// The counts of runs as Prometheus reads them: the text format, version 0.0.4. Names, units and
// types follow its conventions; docs/monitoring.md has the list. Pure.
#pragma once

#include <string>
#include <vector>

#include "xauto/machine.h"
#include "xauto/run_look.h"

namespace xauto::cli {

/// Of all runs together: a metric's lines are one group there. Two looks of one run are not allowed.
/// `machine`: of the apps that have joined xauto-system.
[[nodiscard]] std::string metrics_text(const std::vector<RunLook>& runs,
                                       const std::vector<MachineXpu>& machine = {});

/// Upper ends of the histograms' buckets in microseconds: where buckets of the board end, so that
/// every count is exact.
[[nodiscard]] std::vector<std::int64_t> latency_bounds_us();

}  // namespace xauto::cli

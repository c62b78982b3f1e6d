// SPDX-License-Identifier: Apache-2.0
// The report of one or more traces: latencies per chain, the chain that set the worst case and why,
// XPU load, and the schedule of that release. One page, no network.
#pragma once

#include <string>
#include <vector>

#include "xauto/trace_reader.h"

namespace xauto::cli {

struct ReportedTrace {
  std::string id;    ///< the file's name without folder and suffix
  std::string fact;  ///< what report.json adds, for people; may be empty
  ReadTrace trace;
};

/// One step of the chain that set a release's latency.
struct ChainStep {
  std::string xnode, xpu;
  std::int64_t begin_us = 0, end_us = 0;  ///< on the XPU, since the release
  std::int64_t handover_us = 0;           ///< from the step before until it was ready
  std::int64_t waited_us = 0, suspended_us = 0, ran_us = 0;
  std::int64_t planned_us = -1;  ///< its time in the plan; -1: unknown
  std::string waited_for, preempted_by;
};

/// Backwards from the last output: always the one that handed over last. Empty if the trace does
/// not tell.
[[nodiscard]] std::vector<ChainStep> critical_chain(const ReadTrace& trace, std::int64_t release);

[[nodiscard]] std::string html_report(const std::vector<ReportedTrace>& traces);

}  // namespace xauto::cli

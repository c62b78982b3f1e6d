// SPDX-License-Identifier: Apache-2.0
// The report of one or more traces: latencies per chain, the chain that set the worst case and why,
// XPU load, and the schedule of that release. One page, no network.
#pragma once

#include <string>
#include <vector>

#include "story/timeline.h"
#include "story/trace_reader.h"

namespace xauto::story {

struct ReportedTrace {
  std::string id;  ///< the file's name without folder and suffix
  ReadTrace trace;
};

/// A panel for each module that published: what ran between its slowest release and that result.
/// `id` is of letters, digits and '-'.
[[nodiscard]] std::vector<Panel> output_panels(const std::string& id, const std::string& name,
                                               const ReadTrace& trace);

/// A table of its chains beside what is claimed of them, as the whole run counted them, and what became of
/// the claims; of a run that goes on, and where nothing is counted by chain, what the trace has, or nothing.
[[nodiscard]] std::string counts_section(const std::string& title, const ReadTrace& trace);

[[nodiscard]] std::string html_report(const std::vector<ReportedTrace>& traces);

}  // namespace xauto::story

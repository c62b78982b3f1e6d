// SPDX-License-Identifier: Apache-2.0
// What one or more runs come to: report.json, the table for people, the trace and the page.
#pragma once

#include <string>
#include <vector>

#include "story/page.h"

#include "xauto/run_app.h"

namespace xauto::cli {

/// Every release accounted for, none dropped, no coordinator or emulator lost. If not, it logs why:
/// the exit status will be 1.
[[nodiscard]] bool is_healthy(const PolicyRun& run);

/// {"runs":[{"policy":"ros2","p50_us":…,"p99_us":…,"max_us":…,…},…],…},
/// docs/formats.md.
[[nodiscard]] std::string report_json(const RunFlags& flags, const std::vector<PolicyRun>& runs);
[[nodiscard]] std::string report_table(const RunFlags& flags, const std::vector<PolicyRun>& runs);
/// The run as a file for Perfetto's viewers. Errors: it left no trace.
[[nodiscard]] Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run);
/// The same of what surrounds an incident, while the run goes on: no report yet.
[[nodiscard]] Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run,
                                              const launch::Incident& incident);
/// "release 12 missed its deadline: 17.31 ms"
[[nodiscard]] std::string words_of(const RunFlags& flags, const launch::Incident& incident);
/// What a page shows of such a trace, which is in `file` (story/page.h).
[[nodiscard]] Result<story::PagedRun> paged_of(const std::string& trace, std::string file);

}  // namespace xauto::cli

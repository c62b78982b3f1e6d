// SPDX-License-Identifier: Apache-2.0
// A run as a trace file for Perfetto's viewers: what is drawn, and where. docs/timeline.md has the
// picture.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/policy.h"
#include "model/tables.h"
#include "story/story.h"
#include "story/trace_reader.h"

namespace xauto::story {

/// A row of the picture: an XPU, or several that are one pool.
struct Row {
  std::string name;
  bool exclusive = true;  ///< at most one job at a time: an overlap is a late time stamp
  bool here = true;       ///< false: of another host, whose part draws it
};

/// Of a run with tables that is over, what its report says of a scenario and of a change. -1: not known, or of a
/// worst case: nothing is claimed.
struct ScenarioInfo {
  std::string name, table;
  std::uint64_t releases = 0;
};
struct ChangeInfo {
  std::uint64_t release = 0;
  std::string from, to;
  std::string chain;  ///< whose result met it; empty: none did
  std::int64_t spanned_us = -1, worst_case_us = -1;
};

struct Scene {
  std::string title, note;
  std::vector<Row> rows;
  std::vector<int> row_of;  ///< XPU -> row
  std::vector<ModuleInfo> modules;
  std::vector<std::int64_t> priorities;  ///< by XNode; empty: none
  const Policy* keys = nullptr;          ///< the run went by; null: by none
  const Tables* tables = nullptr;        ///< likewise
  std::vector<ScenarioInfo> scenarios;   ///< empty: the run goes on
  std::vector<ChangeInfo> changes;       ///< likewise; the last ones
  std::vector<ChainClaim> claims;        ///< [chain]; empty: nothing is claimed
  std::vector<ChainCounts> counts;       ///< of a run that is over
  std::string verdict;                   ///< ... and what became of it in this run
  /// Of a host's part of a run. Files of all parts, one behind the other, are one timeline: tracks stay apart by `group`,
  /// from 1 on, and arrows cross.
  std::uint32_t group = 1;
  std::vector<std::string> elsewhere = {};  ///< [module] which other host has it; empty: none
};

/// The file. Errors: an XPU has no row.
[[nodiscard]] Result<std::string> perfetto_trace(const AppSpec& app, const Scene& scene,
                                                 const Story& story, std::int64_t clock_offset_ns);

}  // namespace xauto::story

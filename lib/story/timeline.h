// SPDX-License-Identifier: Apache-2.0
// The picture of what was scheduled: one self-contained HTML page, a Gantt chart per policy.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace xauto::story {

enum class BarKind : std::uint8_t {
  kRun,     ///< on the XPU
  kSwitch,  ///< context switch or preemption cost
};

struct Bar {
  int row = 0;  ///< index into Panel::rows
  std::string xnode, module;
  std::int64_t begin_us = 0, end_us = 0;  ///< since the sensors' release
  BarKind kind = BarKind::kRun;
};

/// One policy, or one output of it.
struct Panel {
  std::string id, name = {};
  std::vector<std::string> rows = {};  ///< XPU instances
  std::optional<std::int64_t> p50_us = {}, p99_us = {},
                              max_us = {};      ///< missing: nothing was measured
  std::vector<std::int64_t> latencies_us = {};  ///< of each result; empty: nothing is shown
  std::int64_t shown_sequence = 0;              ///< the slowest: `measured` shows it
  std::int64_t shown_latency_us = 0;
  std::vector<Bar> measured = {};
};

struct Timeline {
  std::string title;
  std::string note;  ///< conditions: platform, emulated or not, number of activations
  std::vector<Panel> panels;
  std::string sections = {};  ///< HTML above the panels; its author has escaped it
};

/// Text for between HTML's tags, or for an attribute in double quotes.
[[nodiscard]] std::string html_safe(const std::string& text);

/// The whole page. Names are escaped; needs no network.
[[nodiscard]] std::string timeline_html(const Timeline& timeline);

}  // namespace xauto::story

// SPDX-License-Identifier: Apache-2.0
// A run as ROS 2's /diagnostics has it: a status per chain, module and XPU, and one for what the
// certified worst cases take for granted. Keys and levels of a chain are those of Autoware's nodes for
// processing times; what they compare with is the certificate's, or stated, and never typed in here.
// docs/monitoring.md has the rules. Pure.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "xauto/run_look.h"

namespace xauto::cli {

/// diagnostic_msgs/msg/DiagnosticStatus has these numbers.
enum class Level : std::uint8_t { kOk = 0, kWarn = 1, kError = 2, kStale = 3 };
[[nodiscard]] const char* to_string(Level level);

struct Diagnostic {
  Level level = Level::kOk;
  std::string name, message, hardware_id;
  std::vector<std::pair<std::string, std::string>> values;
};

/// `before`: the look before; null: there was none. Levels are about what happened in between.
[[nodiscard]] std::vector<Diagnostic> diagnostics_of(const RunLook& now, const RunLook* before);
/// The same statuses of a run that has ended, or cannot be looked at any more: all are stale.
[[nodiscard]] std::vector<Diagnostic> stale(std::vector<Diagnostic> last, const std::string& why);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// What is behind RunOptions and RunReport.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include <xauto/run.h>

#include "session/run_report.h"
#include "session/session.h"

namespace xauto {

struct RunOptions::Data {
  std::string app, policy, platform = "small", deployment, scheduling = "xauto", cpu_sched = "fifo";
  std::string input, record, overload, programs;
  std::optional<std::vector<std::string>> emulate;
  bool real = false, lockstep = false;
  std::uint64_t activations = 200;
  std::chrono::microseconds duration{0}, period{0};

  /// Reads and checks all of it, as `xauto run` does.
  [[nodiscard]] Result<runtime::Session> session() const;
  [[nodiscard]] Status take_policy(runtime::Session& session) const;
};

struct RunReport::Data {
  runtime::RunReport report;
  std::string app;
  bool emulator_died = false;
};

}  // namespace xauto

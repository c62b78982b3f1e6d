// SPDX-License-Identifier: Apache-2.0
// What a coordinator says of its XPU and workers: `xauto top` asks for it.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/json_value.h"
#include "model/platform.h"

namespace xauto {

struct WorkerStatus {
  std::string worker;  ///< "fcd@gpu0"
  std::string state;   ///< "idle", "starting", "running", "waiting", "suspended" ...
  // Of the job, unless idle:
  std::string xnode;
  std::uint64_t job = 0;  ///< its activation's number
  std::int64_t priority = 0;
  std::uint64_t since_us = 0;  ///< START was so long ago
  std::string by;              ///< the XNode for which it waits; empty: for none
  /// Of a policy of keys, instead of a priority: its key is so far ahead; below 0: it is past.
  std::optional<std::int64_t> due_us = {};

  [[nodiscard]] bool idle() const { return state == "idle"; }
  bool operator==(const WorkerStatus&) const = default;
};

struct XpuStatus {
  std::string xpu;
  std::int64_t pid = 0;  ///< the coordinator's
  Discipline discipline = Discipline::kGate;
  bool arbitrated = false;  ///< the coordinator decides; else the workers among themselves
  std::uint64_t looks = 0, decisions = 0;
  std::vector<WorkerStatus> workers;

  bool operator==(const XpuStatus&) const = default;
};

[[nodiscard]] Json to_json(const XpuStatus& status);
/// Errors: not of this form; whoever answers may be anybody.
[[nodiscard]] Result<XpuStatus> parse_xpu_status(const Json& json);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// /diagnostics of ROS 2, over DDS: where `xauto monitor` publishes.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "transport/bridge.h"

#include "xauto/diagnostics.h"

namespace xauto::cli {

/// Threads: one.
class DiagnosticsTopic {
 public:
  /// In the domain of ROS_DOMAIN_ID. Errors: no plug-in, no DDS.
  [[nodiscard]] static Result<DiagnosticsTopic> open();
  /// One diagnostic_msgs/msg/DiagnosticArray, stamped now. Never waits.
  void publish(const std::vector<Diagnostic>& statuses);
  /// Sends what waits, for a second at most; what went wrong since the start, a line each.
  [[nodiscard]] std::vector<std::string> close();

 private:
  OneThread thread_;
  std::unique_ptr<transport::Bridge> bridge_;
  std::shared_ptr<transport::Publisher> publisher_;
  std::uint64_t number_ = 0;
};

}  // namespace xauto::cli

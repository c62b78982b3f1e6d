// SPDX-License-Identifier: Apache-2.0
// The deployed policy as others see it: its rows in the run's BPF map (kernel/policy_map.h).
//
// Threads: one at a time.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "kernel/policy_map.h"
#include "model/policy_row.h"

namespace xauto::xpu {

/// Texts that are too long for the map are cut.
[[nodiscard]] xauto_bpf_policy shown(const PolicyRow& row);

class PolicyView {
 public:
  /// With as many rows for ever. kPermission: the hint says who may.
  [[nodiscard]] static Result<PolicyView> create(const std::vector<PolicyRow>& rows);
  /// That of a run that goes on.
  [[nodiscard]] static Result<PolicyView> open(const std::string& run);
  [[nodiscard]] Status pin(const std::string& folder) const { return map_.pin(folder); }
  /// No system call.
  [[nodiscard]] Status put(const std::vector<PolicyRow>& rows);

 private:
  explicit PolicyView(kernel::PolicyMap map) : map_(std::move(map)) {}
  kernel::PolicyMap map_;
};

}  // namespace xauto::xpu

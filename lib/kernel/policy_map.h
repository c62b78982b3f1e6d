// SPDX-License-Identifier: Apache-2.0
// The policy that a run has deployed, as a BPF map that `bpftool map dump` prints by names: a row per XNode
// (include/uapi/xauto/bpf.h, "policy"). It is made by bpf(2) alone, with a type description of its own: no libbpf, no BPF
// program, no BTF of the kernel's, so an app has it too, and on any kernel with bpf(2).
//
// Threads: one at a time.
#pragma once

#include <string>
#include <vector>

#include <uapi/xauto/bpf.h>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "kernel/bpf_sys.h"

namespace xauto::kernel {

class PolicyMap {
 public:
  /// With room for these rows, and no others. kPermission: the hint says who may.
  [[nodiscard]] static Result<PolicyMap> create(const std::vector<xauto_bpf_policy>& rows);
  /// The one that a run has pinned.
  [[nodiscard]] static Result<PolicyMap> open(const std::string& run);
  /// In a folder of bpffs, as "policy", in place of what is there.
  [[nodiscard]] Status pin(const std::string& folder) const;
  /// What is in force from now on: as many rows as it was made with. No system call.
  [[nodiscard]] Status put(const std::vector<xauto_bpf_policy>& rows);
  [[nodiscard]] std::vector<xauto_bpf_policy> rows() const;

 private:
  PolicyMap() = default;
  UniqueFd fd_;
  MappedMap map_;
};

}  // namespace xauto::kernel

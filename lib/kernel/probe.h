// SPDX-License-Identifier: Apache-2.0
// What this machine offers to XAuto, and what to do about what is missing.
#pragma once

#include <functional>
#include <string>
#include <vector>

namespace xauto::kernel {

enum class Verdict {
  kOk,        ///< there
  kDegraded,  ///< XAuto works, with less
  kMissing,   ///< not there; XAuto works without it where `meaning` says so
};

struct Finding {
  std::string id;  ///< stable, for programs: "sched_ext"
  Verdict verdict = Verdict::kMissing;
  std::string found;    ///< what was seen
  std::string meaning;  ///< what follows from it
  std::string advice;   ///< what to do; empty if there is nothing to do
};

/// What the probes ask the running kernel rather than a file; a test gives its own.
struct Permitted {
  std::string kernel_release;
  int cores = 0;         ///< that this process may use
  int highest_fifo = 0;  ///< SCHED_FIFO priority that this process may use; 0: none
  unsigned long rtprio_limit = 0;
  unsigned long long memlock_bytes = 0;  ///< ~0: unlimited
  bool root = false;
  bool may_use_bpf = false;
  bool has_bpf = true;  ///< bpf(2) is in the kernel
  [[nodiscard]] static Permitted of_this_process();
};

/// Is xauto.ko loaded?
[[nodiscard]] bool module_is_loaded(const std::string& root = {});

/// A kind of XPU that needs a driver; the table is xpu/kind.h's.
struct Device {
  std::string type;                ///< "gpu"
  std::vector<std::string> nodes;  ///< any of them will do
  std::string what, driver, advice;
  std::function<std::string(const std::string& root)> suspended = {};  ///< "suspended by ..."
};

/// `root`: "" for this machine, or a folder that stands for / in tests. Changes nothing, needs no
/// privilege.
[[nodiscard]] std::vector<Finding> probe(const std::string& root, const Permitted& limits,
                                         const std::vector<Device>& devices);

}  // namespace xauto::kernel

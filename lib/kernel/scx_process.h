// SPDX-License-Identifier: Apache-2.0
// xauto-cpusched as a child process: started, waited for until the scheduler is enabled, watched.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/process.h"

namespace xauto::kernel {

struct ScxProcess {
  Child child;
  std::string why;  ///< "full mode: CPU 1 is not isolated, ..."
};

/// `bin`: folder of the program. `arguments`: more options of xauto-cpusched. An Error says in one
/// line why sched_ext cannot be used, and comes with nothing left behind.
[[nodiscard]] Result<ScxProcess> start_scx(const std::string& bin, const std::string& run,
                                           const std::vector<int>& cpus,
                                           const std::vector<std::string>& arguments = {});

}  // namespace xauto::kernel

// SPDX-License-Identifier: Apache-2.0
// One run at one moment: all that `xauto monitor` exports. Read from the run's board and its
// coordinators' answers, by a process of its own: no thread of the run knows that it is looked at.
#pragma once

#include <string>
#include <vector>

#include "model/xpu_status.h"

#include "xauto/counts.h"

namespace xauto::cli {

struct RunLook {
  std::string run, app, platform, scheduling;
  Counts counts;
  std::vector<XpuStatus> xpus;  ///< of the coordinators that have answered
  std::string host = {};        ///< whose part of a run it is; empty: it has no parts
};

}  // namespace xauto::cli

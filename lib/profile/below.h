// SPDX-License-Identifier: Apache-2.0
// On an XPU with levels a more urgent job waits for what less urgent ones have running and nobody can take off, once
// for each kernel that it launches, and shares the XPU with them where it does not fill it. So it is timed beside them:
// beside each alone, whose long blocks may fill the XPU, and beside one of each module at a time, which together may
// leave no room where none of them fills it. The block scheduler of a GPU takes blocks of higher priority first and
// takes none off (CUDA's driver API, cuStreamCreateWithPriority), so more of them than levels never meet a job.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <xauto/result.h>

namespace xauto::runtime {

/// Threads that repeat a job each. Threads: begin() and end() from one.
class Below {
 public:
  /// On these cores: where the job above runs, their threads would wait for a core and not for the XPU.
  [[nodiscard]] static std::unique_ptr<Below> on(const std::vector<int>& cores);
  virtual ~Below() = default;
  /// Returns when each is about to be called for the first time; it is called again and again until end().
  [[nodiscard]] virtual Status begin(std::vector<std::function<Status()>> jobs) = 0;
  /// Returns when no call is left. The first error of one, if there was any.
  [[nodiscard]] virtual Status end() = 0;
};

/// What is to run below an XNode, by turns: the XNodes of a set on levels from the lowest on. `others`: by module, those
/// of other modules on that XPU.
[[nodiscard]] std::vector<std::vector<int>> sets_below(const std::vector<std::vector<int>>& others,
                                                       int levels);

}  // namespace xauto::runtime

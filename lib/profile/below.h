// SPDX-License-Identifier: Apache-2.0
// On an XPU with levels a more urgent job waits for what less urgent ones have running and nobody can take off, once
// for each kernel that it launches, and shares the XPU with them where it does not fill it. So it is timed beside one.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <xauto/result.h>

namespace xauto::runtime {

/// A thread that repeats a job. Threads: begin() and end() from one.
class Below {
 public:
  /// On these cores: where the job above runs, its thread would wait for a core and not for the XPU.
  [[nodiscard]] static Result<std::unique_ptr<Below>> start(const std::vector<int>& cores);
  virtual ~Below() = default;
  /// Returns when `job` is about to be called for the first time; it is called again and again until end().
  virtual void begin(std::function<Status()> job) = 0;
  /// Returns when no call is left. The first error of one, if there was any.
  [[nodiscard]] virtual Status end() = 0;
};

}  // namespace xauto::runtime

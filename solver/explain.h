// SPDX-License-Identifier: Apache-2.0
// Why is the latency what it is: the chain of waits and runs that ends with the last finish, and
// the XPU that limits it. And what would help: the same app solved on a platform with one more XPU.
#pragma once

#include <string>
#include <vector>

#include "solver/solve.h"

namespace xauto::solver {

/// One link of the chain, from time 0 to the end, without a gap.
struct ChainLink {
  int xnode = -1;
  Time ready_us = 0, start_us = 0, finish_us = 0;
  Time wcet_us = 0;
  /// Who held its XPU between `ready` and `finish` while it did not run itself; empty: nobody.
  std::vector<int> behind;
};

struct Explanation {
  std::vector<ChainLink> chain;
  int limiting_xpu = -1;  ///< on which the chain spends (running or waiting) the most time
  Time limiting_us = 0;   ///< that time
  Time running_us = 0;  ///< of the chain's XNodes at their WCET; the rest is waiting and preemption
  Time critical_path_us = 0;  ///< no assignment on any number of XPUs is shorter
  std::string sentence;       ///< the above for people
};

[[nodiscard]] Result<Explanation> explain(const AppSpec& app, const Platform& platform,
                                          const Policy& policy);

/// One change and what it would bring.
struct WhatIf {
  std::string change;  ///< "one more gpu", "fcd.infer on gpu, if 9.00 ms"
  Time latency_us = 0, lower_bound_us = 0;
  double gain = 0;  ///< (before - after) / before
};

/// One more instance of each type, and, for each type an XNode of the latency's chain lacks, an
/// implementation there. Its assumed WCET: its least one, times the mean ratio of that type to the
/// XNodes' least over those that have both; where that would be slower than what the XNode has,
/// nothing is assumed. Each answer is a search of `options`; sorted by gain.
[[nodiscard]] Result<std::vector<WhatIf>> what_if(const AppSpec& app, const Platform& platform,
                                                  const Policy& policy,
                                                  const SolveOptions& options);
/// One named case: XNode `xnode` gets an implementation for `type` with this WCET.
[[nodiscard]] Result<WhatIf> what_if_implemented(const AppSpec& app, const Platform& platform,
                                                 const Policy& policy, const std::string& xnode,
                                                 const std::string& type, Time wcet_us,
                                                 const SolveOptions& options);

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// What a user would otherwise pick, on the same DAG: other solvers on the paper's model, if they
// are installed. They are looked up when the bench runs; nothing of them is linked.
#pragma once

#include <string>
#include <vector>

#include "bench/synthetic/measure.h"

namespace xauto::bench {

struct Yardstick {
  std::string name;
  bool present = false;
  std::string status;            ///< "optimal", "time limit", ... as the program says
  std::int64_t makespan_us = 0;  ///< of the model's solution; 0: none found
  double seconds = 0;
};

/// Runs each one for at most `limit_s` in `folder`.
[[nodiscard]] Result<std::vector<Yardstick>> run_yardsticks(const AppSpec& app,
                                                            const Platform& platform,
                                                            double limit_s,
                                                            const std::string& folder);

}  // namespace xauto::bench

// SPDX-License-Identifier: Apache-2.0
// Job shops as apps: a type per machine, a chain of XNodes per job.
#pragma once

#include <utility>
#include <vector>

#include "model/app.h"
#include "model/platform.h"

#include "problem_random.h"

namespace xauto::solver::test {

/// One instance per type, none preemptive: `jobs` lists (machine, time) one after the other.
struct JobShop {
  AppSpec app;
  Platform platform;
};

inline JobShop job_shop(int machines, const std::vector<std::vector<std::pair<int, int>>>& jobs) {
  JobShop shop;
  shop.app.name = "job-shop";
  shop.platform.name = "machines";
  for (int m = 0; m < machines; ++m)
    shop.platform.xpus.push_back({numbered("m", m), numbered("t", m), false});
  for (std::size_t j = 0; j < jobs.size(); ++j)
    for (std::size_t k = 0; k < jobs[j].size(); ++k) {
      const auto [machine, time] = jobs[j][k];
      const int i = static_cast<int>(shop.app.xnodes.size());
      shop.app.xnodes.push_back(
          {numbered("x", i), numbered("j", static_cast<int>(j)), {{numbered("t", machine), time}}});
      if (k > 0) shop.app.edges.emplace_back(i - 1, i);
    }
  return shop;
}

/// Fisher and Thompson's 6 x 6 ("Industrial Scheduling", Muth and Thompson, 1963; as in the public
/// JSPLIB, ft06). Optimum 55.
inline JobShop ft06() {
  return job_shop(6, {{{2, 1}, {0, 3}, {1, 6}, {3, 7}, {5, 3}, {4, 6}},
                      {{1, 8}, {2, 5}, {4, 10}, {5, 10}, {0, 10}, {3, 4}},
                      {{2, 5}, {3, 4}, {5, 8}, {0, 9}, {1, 1}, {4, 7}},
                      {{1, 5}, {0, 5}, {2, 5}, {3, 3}, {4, 8}, {5, 9}},
                      {{2, 9}, {1, 3}, {4, 5}, {5, 4}, {0, 3}, {3, 1}},
                      {{1, 3}, {3, 3}, {5, 9}, {0, 10}, {4, 4}, {2, 1}}});
}

}  // namespace xauto::solver::test

// SPDX-License-Identifier: Apache-2.0
// The rule of solver/problem.h once more, so simply that it can be compared with the text: it steps
// through every microsecond and looks at everything each time. For tests only; shares nothing with
// solver/simulate.cc.
#pragma once

#include <vector>

#include "solver/problem.h"

namespace xauto::solver::test {

struct NaiveSchedule {
  Time makespan = 0;
  std::vector<Time> start, finish;
};

inline NaiveSchedule naive_simulate(const Problem& p, const Decision& d,
                                    const std::vector<Time>& actual = {}) {
  const auto n = static_cast<std::size_t>(p.num_xnodes);
  NaiveSchedule result;
  result.start.assign(n, -1);
  result.finish.assign(n, -1);
  std::vector<Time> left(n);
  for (std::size_t i = 0; i < n; ++i)
    left[i] = actual.empty() ? p.wcet_on(static_cast<int>(i), d.xpu[i]) : actual[i];
  std::vector<int> on(static_cast<std::size_t>(p.num_xpus), -1);

  const auto eligible = [&](std::size_t i) {
    if (result.finish[i] >= 0) return false;
    for (const int u : p.pred[i])
      if (result.finish[static_cast<std::size_t>(u)] < 0) return false;
    for (const auto& [u, v] : d.order)
      if (static_cast<std::size_t>(v) == i && result.finish[static_cast<std::size_t>(u)] < 0)
        return false;
    return true;
  };
  for (Time now = 0;; ++now) {
    for (bool again = true; again;) {
      again = false;
      // Everything that is due finishes ...
      for (int& i : on)
        if (i >= 0 && left[static_cast<std::size_t>(i)] == 0) {
          result.finish[static_cast<std::size_t>(i)] = now;
          result.makespan = now;
          i = -1;
        }
      // ... then every XPU decides.
      for (std::size_t m = 0; m < on.size(); ++m) {
        int best = -1;
        for (std::size_t i = 0; i < n; ++i)
          if (static_cast<std::size_t>(d.xpu[i]) == m && eligible(i) &&
              (best < 0 || d.priority[i] > d.priority[static_cast<std::size_t>(best)]))
            best = static_cast<int>(i);
        if (best < 0 || best == on[m]) continue;
        if (on[m] >= 0 && !p.preemptive[m]) continue;
        int open = 0;
        for (std::size_t i = 0; i < n; ++i)
          if (static_cast<std::size_t>(d.xpu[i]) == m && result.start[i] >= 0 &&
              result.finish[i] < 0)
            ++open;
        if (on[m] >= 0 && p.levels[m] != 0 && open == p.levels[m]) continue;
        const bool above_others =
            p.levels[m] != 0 && open > 0 && result.start[static_cast<std::size_t>(best)] < 0;
        if (on[m] >= 0 || above_others) left[static_cast<std::size_t>(best)] += p.preempt[m];
        on[m] = best;
        if (result.start[static_cast<std::size_t>(best)] < 0)
          result.start[static_cast<std::size_t>(best)] = now;
      }
      for (const int i : on) again = again || (i >= 0 && left[static_cast<std::size_t>(i)] == 0);
    }
    bool idle = true;
    for (const int i : on)
      if (i >= 0) {
        --left[static_cast<std::size_t>(i)];
        idle = false;
      }
    if (idle) return result;
  }
}

}  // namespace xauto::solver::test

// SPDX-License-Identifier: Apache-2.0
// The exact event-driven simulator: what an assignment and its priorities do, to the microsecond.
#pragma once

#include <span>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

/// One stretch of time during which an XNode (or a context switch on its behalf) holds an XPU.
struct Slice {
  int xnode = -1, xpu = -1;
  Time begin = 0, end = 0;
  bool switching = false;  ///< preemption or context-switch cost, not progress
};

struct Simulation {
  Time makespan = 0;
  std::vector<int> xpu;  ///< where each XNode ran
  std::vector<Time> start, finish;
  std::vector<Slice> slices;  ///< only if asked for
  std::int64_t preemptions = 0;
};

struct SimulateOptions {
  bool slices = false;
  /// Actual execution times instead of the WCETs, [xnode], each in 0..WCET; empty: WCET.
  std::span<const Time> actual = {};
};

/// The rule of problem.h.
[[nodiscard]] Simulation simulate(const Problem& problem, const Decision& decision,
                                  const SimulateOptions& options = {});

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// The exact event-driven simulator: what an assignment and its priorities do, to the microsecond.
#pragma once

#include <span>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

enum class Model {
  kXAuto,      ///< fixed priorities, preemption with cost: the rule in problem.h
  kRos2,       ///< everybody picks his fastest XPU type; CPUs shared fairly, others round-robin
  kTimeshare,  ///< the policy's assignment without scheduling: every instance time-shares
};

/// One stretch of time during which an XNode (or a context switch on its behalf) holds an XPU.
struct Slice {
  int xnode = -1, xpu = -1;
  Time begin = 0, end = 0;
  bool switching = false;  ///< preemption or context-switch cost, not progress
};

struct Simulation {
  Time makespan = 0;
  std::vector<int> xpu;  ///< where each XNode ran; for kRos2 on a pool: the type's first instance
  std::vector<Time> start, finish;
  std::vector<Slice> slices;  ///< only if asked for; in shared (processor-sharing) models they overlap
  std::int64_t preemptions = 0;
};

struct SimulateOptions {
  bool slices = false;
  /// Actual execution times instead of the WCETs, [xnode], each in 0..WCET; empty: WCET.
  std::span<const Time> actual = {};
  /// kRos2/kTimeshare: ideal sharing without time slices or switch cost, whatever the platform says.
  bool ideal_sharing = false;
};

/// kXAuto: the rule of problem.h.
[[nodiscard]] Simulation simulate(const Problem& problem, const Decision& decision,
                                  const SimulateOptions& options = {});

/// kRos2 (decision ignored) and kTimeshare. CPU-type XPUs: ideal processor sharing (a job never gets more
/// than one core); in kRos2 the cores are one pool, in kTimeshare each core is shared by the XNodes
/// assigned to it. Every other XPU: round-robin by timeslice_us, effective_switch_us at each change of
/// context, in order of arrival; timeslice_us = 0: ideal sharing. kRos2 with several instances of a type: an arriving
/// XNode joins the instance with the fewest XNodes at that moment (lowest index first).
[[nodiscard]] Simulation simulate_shared(const Problem& problem, const Platform& platform, Model model,
                                         const Decision& decision, const SimulateOptions& options = {});

}  // namespace xauto::solver

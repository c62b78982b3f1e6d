// SPDX-License-Identifier: Apache-2.0
// What the checker knows of app and platform, its own execution of the rule of problem.h, and its
// own proof of a lower bound. Private to verify*.cc; nothing of the solver is used here, on
// purpose.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"

namespace xauto::solver::verification {

using Us = std::int64_t;

struct World {
  int n = 0, m = 0;
  std::vector<std::vector<int>> before, after;       ///< edges
  std::vector<std::vector<std::optional<Us>>> wcet;  ///< [xnode][xpu]
  std::vector<char> preemptive;                      ///< [xpu]
  std::vector<Us> preempt_us;                        ///< [xpu]
  std::vector<int> levels;                           ///< [xpu], 0: any number
  std::vector<int> kind;                             ///< [xpu]: equal for instances that are alike
  std::vector<int> first_to_last;                    ///< an order that respects the edges

  World(const AppSpec& app, const Platform& platform);
  [[nodiscard]] Us least(int xnode) const;
  [[nodiscard]] bool preemption_is_free()
      const;  ///< every XPU preemptive, at no cost and without limit
  /// The same XPUs, all preemptive and for free: whatever runs on *this can run there, no longer.
  [[nodiscard]] World relaxed() const;
};

struct Candidate {
  std::vector<int> xpu;
  std::vector<std::int64_t> priority;
  std::vector<std::vector<int>> order_before;  ///< [xnode] run-time order predecessors
};

struct Execution {
  std::vector<Us> start, finish;
  Us latency = 0;
};

/// Fixed-priority execution of `candidate`, each XNode taking `takes[xnode]`.
[[nodiscard]] Execution execute(const World& world, const Candidate& candidate,
                                const std::vector<Us>& takes);

/// The schedule that starts the XNodes of each XPU one by one in `sequence`, each as soon as it
/// can, never preempting: possible on every XPU, if need be by leaving it idle.
[[nodiscard]] Us in_sequence(const World& world, const std::vector<int>& xpu,
                             const std::vector<int>& sequence);

/// Longest chain of least WCETs, and work that only one set of instances can do: proven for every
/// schedule.
[[nodiscard]] Us simple_bound(const World& world);

enum class Proof {
  kHolds,    ///< nothing is shorter than the target
  kBeaten,   ///< something shorter exists
  kUnknown,  ///< budget spent, or the argument is not strong enough
};

/// Over all ways to choose a type per XNode: chains, and what must fit between a head and a tail on
/// the instances of a type. Valid for schedules of every kind. Never says kBeaten.
[[nodiscard]] Proof prove_by_types(const World& world, Us target, std::int64_t budget);

/// Over all assignments and priorities, decision by decision. On a World whose preemption is free
/// this covers schedules of every kind: in any schedule, let every XPU run the ready XNode that
/// finishes first in it; by the exchange argument for earliest deadlines no XNode then finishes
/// later (docs/ilp.md).
[[nodiscard]] Proof prove_by_execution(const World& world, Us target, std::int64_t budget);

}  // namespace xauto::solver::verification

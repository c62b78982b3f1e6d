// SPDX-License-Identifier: Apache-2.0
// Problem: an AppSpec on a Platform, compiled to dense arrays. Everything in solver/ reads this.
//
// The execution rule, exactly (the simulator, the search, the bounds, the checker and the naive
// simulator in the tests all implement this text, each on its own):
//
//  * Time is integer microseconds. Every XNode without predecessors is released at 0; any other one
//    is ready when its last predecessor has finished. XNode i on XPU m takes wcet(i, type(m)).
//  * Each XPU runs at most one XNode at a time: the ready one of highest priority (larger = more
//    urgent) among those on it that are eligible, i.e. whose run-time order predecessors
//    (PriorityPlan::order) have finished. It never idles while an eligible one is ready.
//  * Preemptive XPU: a ready, eligible XNode of higher priority than the running one suspends it at
//    once. The XNode that starts by preempting another occupies the XPU for preempt_us more (its
//    own remaining time grows by preempt_us). Resuming a suspended XNode is free. The first start
//    on an idle XPU is free.
//  * Preemptive XPU with L levels: the same as long as fewer than L of its XNodes have started and
//    not ended. Once L have, the running one runs to its end: to preempt it, the hardware would
//    need a level above it. Whoever starts while others have started and not ended pays preempt_us,
//    also if the running one ends at that instant: the hardware goes back to them at once.
//  * Non-preemptive XPU: the running XNode runs to its end.
//  * Everything that finishes at one instant finishes before any XPU decides at that instant.
//  * start = when the XNode is first put on its XPU (before preempt_us is paid); finish = its end.
//
// Makespan (end-to-end latency) = the largest finish.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"

namespace xauto::solver {

using Time = std::int64_t;  ///< microseconds
inline constexpr Time kCannotRun = -1;

/// What is minimised, if not the makespan alone (objectives.h):
///   cost = makespan + kLate * sum over i of max(0, finish_i - deadline_i)
struct Goal {
  static constexpr Time kNone = std::int64_t{1} << 60;
  static constexpr Time kLate = 1000;
  std::vector<Time> deadline;  ///< [xnode], kNone where there is none; empty: the makespan alone

  [[nodiscard]] bool plain() const { return deadline.empty(); }
  /// What a finish adds to the cost beside the makespan.
  [[nodiscard]] Time charge(std::size_t xnode, Time finish) const {
    return finish > deadline[xnode] ? kLate * (finish - deadline[xnode]) : 0;
  }
};

struct Problem {
  int num_xnodes = 0, num_xpus = 0, num_types = 0;
  std::vector<std::string> type_name;       ///< [type]
  std::vector<int> xpu_type;                ///< [xpu] -> type
  std::vector<std::vector<int>> type_xpus;  ///< [type] -> its XPU instances, ascending
  std::vector<char> preemptive;             ///< [xpu]
  std::vector<Time> preempt;                ///< [xpu] preempt_us
  std::vector<int> levels;                  ///< [xpu] 0: it preempts without limit
  std::vector<Time> wcet_flat;  ///< [xnode * num_types + type], kCannotRun if no implementation
  std::vector<std::vector<int>> pred, succ;  ///< direct precedence, as given
  std::vector<int> topo;                     ///< a topological order

  // Constraints of the user (objectives.h); empty: none.
  std::vector<char> forbidden;           ///< [xnode * num_xpus + xpu]
  std::vector<std::vector<int>> groups;  ///< XNodes that must share an instance
  Goal goal;

  [[nodiscard]] Time wcet(int xnode, int type) const {
    return wcet_flat[static_cast<std::size_t>(xnode) * static_cast<std::size_t>(num_types) +
                     static_cast<std::size_t>(type)];
  }
  /// kCannotRun also where the user forbids it.
  [[nodiscard]] Time wcet_on(int xnode, int xpu) const {
    if (!forbidden.empty() && forbidden[static_cast<std::size_t>(xnode) * xpu_type.size() +
                                        static_cast<std::size_t>(xpu)] != 0)
      return kCannotRun;
    return wcet(xnode, xpu_type[static_cast<std::size_t>(xpu)]);
  }

  /// From now on whoever starts while others of its XPU have started and not ended pays preempt_us, wherever it
  /// preempts: as with levels, of which there are enough for all.
  void let_all_nested_pay();

  /// Validates both (kInvalid) and that every XNode can run somewhere (kInfeasible, named).
  [[nodiscard]] static Result<Problem> create(const AppSpec& app, const Platform& platform);
};

/// An answer of the decision variables alone: XPU and priority per XNode, plus run-time order
/// pairs.
struct Decision {
  std::vector<int> xpu;
  std::vector<std::int64_t> priority;  ///< unique per XPU
  std::vector<std::pair<int, int>> order;
};

/// Earlier `key` = more urgent; priorities num_xnodes..1, unique over all XNodes (ties: smaller
/// index).
[[nodiscard]] std::vector<std::int64_t> priorities_by_key(const std::vector<Time>& key);

}  // namespace xauto::solver

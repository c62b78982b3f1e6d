// SPDX-License-Identifier: Apache-2.0
// The SCHED_FIFO priorities of one run, all below the kernel's own watchdogs and migration threads
// (99), and how they are pressed into a smaller range, where the process's limit is lower. What
// keeps its order: coordinators over management, so that a decision is not delayed by those who
// wait for it; management over execution, so that a suspension is never delayed by what it
// suspends; XNodes on real CPUs by the rank of their priority, the most urgent ones last to share; what carries
// messages to other hosts below every XNode.
#pragma once

#include <string>
#include <vector>

#include "model/priority_plan.h"

namespace xauto {

inline constexpr int kFifoHighest = 60;  ///< of coordinators; only the emulator would like more

struct FifoRange {
  int management = 50;
  int sources = 45;
  int execution = 40;  ///< of XPUs other than real CPUs: such a thread mostly waits
  int cpu_lowest = 2, cpu_highest = 39;  ///< XNodes on real CPUs, by policy priority
  int carriers = 1;  ///< of messages between hosts; 0: there is none below the XNodes

  /// From 1 to `highest`, which is rt::highest_fifo(); 0: no priorities at all, all members 0.
  [[nodiscard]] static FifoRange within(int highest);
  [[nodiscard]] bool none() const { return cpu_highest == 0; }
  bool operator==(const FifoRange&) const = default;

  /// Of each XNode on a real CPU: the rank of its policy priority on its XPU, so that any number of
  /// policy priorities fits; the most urgent always gets the highest.
  [[nodiscard]] std::vector<int> by_rank(const PriorityPlan& policy) const;
  /// For the report, where the range up to `highest` is smaller than a run would like; else empty.
  /// `cpus`: XPUs (indices) whose XNodes run by these priorities.
  [[nodiscard]] std::string note(int highest, const PriorityPlan& policy,
                                 const std::vector<int>& cpus) const;
};

}  // namespace xauto

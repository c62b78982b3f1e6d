// SPDX-License-Identifier: Apache-2.0
#include "model/fifo_range.h"

#include <algorithm>
#include <set>

namespace xauto {

FifoRange FifoRange::within(int highest) {
  if (highest <= 0) return {0, 0, 0, 0, 0, 0};
  highest = std::min(highest, kFifoHighest);
  // Levels above those of the CPUs' XNodes, as many as there are; with fewer than four, neighbours
  // share one: first sources with management, then that with the coordinators, then execution with
  // the XNodes on CPUs.
  static constexpr int kLevel[5][3] = {
      // management, sources, execution; the coordinators are at the top
      {0, 0, 0},
      {1, 1, 0},
      {2, 2, 1},
      {2, 2, 1},
      {3, 2, 1}};
  const int above = std::min(4, highest - 1);
  const int* level = kLevel[above];
  const FifoRange wanted;
  const auto at = [&](int index, int preferred) {
    return std::min(highest - (above - index), preferred);
  };
  FifoRange plan;
  plan.management = at(level[0], wanted.management);
  plan.sources = at(level[1], wanted.sources);
  plan.execution = at(level[2], wanted.execution);
  plan.cpu_highest = at(0, wanted.cpu_highest);
  plan.cpu_lowest = std::min(wanted.cpu_lowest, plan.cpu_highest);
  plan.carriers = plan.cpu_lowest - 1;
  return plan;
}

std::vector<int> FifoRange::by_rank(const PriorityPlan& policy) const {
  std::vector<int> fifo(policy.placements.size(), 0);
  for (std::size_t i = 0; i < fifo.size(); ++i) {
    std::set<std::int64_t> above;
    for (const PriorityPlacement& other : policy.placements)
      if (other.xpu == policy.placements[i].xpu && other.priority > policy.placements[i].priority)
        above.insert(other.priority);
    fifo[i] = std::max(cpu_lowest, cpu_highest - static_cast<int>(above.size()));
  }
  return fifo;
}

std::string FifoRange::note(int highest, const PriorityPlan& policy,
                            const std::vector<int>& cpus) const {
  if (none() || *this == FifoRange{}) return {};
  const std::size_t levels =
      static_cast<std::size_t>(cpu_highest) - static_cast<std::size_t>(cpu_lowest) + 1;
  std::size_t sharing = 0;
  for (const int cpu : cpus) {
    std::set<std::int64_t> priorities;
    for (const PriorityPlacement& placement : policy.placements)
      if (placement.xpu == cpu) priorities.insert(placement.priority);
    if (priorities.size() > levels) sharing += priorities.size() - levels + 1;
  }
  std::string text = "SCHED_FIFO is permitted up to " + std::to_string(highest) + ", not " +
                     std::to_string(kFifoHighest) + ": XNodes on CPUs use " +
                     std::to_string(cpu_lowest) + " to " + std::to_string(cpu_highest);
  if (sharing > 0)
    text += "; the " + std::to_string(sharing) + " least urgent of them share the lowest";
  return text;
}

}  // namespace xauto

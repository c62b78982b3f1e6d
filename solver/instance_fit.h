// SPDX-License-Identifier: Apache-2.0
// Do the XNodes that are decided for a type fit on its instances, each within its window? A part of
// the proof (exact.h): the LP of energy_lp.h shares the time of a type out as if an XNode could move
// from one instance to another.
//
// XNodes on one preemptive instance, each with work w in a window [r, d], can be scheduled iff for
// all a < b the work of those with a <= r and d <= b is at most b - a (earliest deadline first;
// Horn 1974). What a policy executes is such a schedule. So if no distribution over the instances
// passes, no policy does. Instances of a type count as alike: that is weaker, never wrong.
#pragma once

#include "solver/energy_lp.h"
#include "solver/problem.h"

namespace xauto::solver {

class InstanceFit {
 public:
  explicit InstanceFit(const Problem& problem);

  /// False: proven that there is none. True: found, or more than `steps` tried.
  [[nodiscard]] bool possible(const Windows& windows, std::int64_t steps);
  /// After possible(): an XPU for each XNode whose type is decided; -1 where none was found.
  [[nodiscard]] const std::vector<int>& xpu() const { return xpu_; }

 private:
  [[nodiscard]] bool place(std::size_t next);
  [[nodiscard]] bool fits(const std::vector<int>& here) const;

  const Problem& problem_;
  const Windows* windows_ = nullptr;
  int type_ = 0;
  std::int64_t steps_ = 0;
  std::vector<int> items_;              ///< still to be placed, earliest first
  std::vector<std::vector<int>> here_;  ///< [instance] -> XNodes by latest finish
  std::vector<int> xpu_;
};

}  // namespace xauto::solver

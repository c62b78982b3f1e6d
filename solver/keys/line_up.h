// SPDX-License-Identifier: Apache-2.0
// Line-up: a start for apps of many components. Sources release all at once now and then; if all components are as
// urgent then, all end late. So here they go one after the other: each XNode of the next one is put where it ends
// first, beside those that came before, with their later releases. When it ends there is its key.
//
// It is a plan of the first releases, and nothing is claimed of it: the search simulates and certifies.
#pragma once

#include <vector>

#include "solver/keys/problem.h"

namespace xauto::solver::keys {

class LineUp {
 public:
  explicit LineUp(const Problem& problem);

  /// Components by what their chains weigh for their work; of equal ones, and without chains, by the period.
  [[nodiscard]] const std::vector<int>& by_weight() const { return by_weight_; }
  /// Of each period by that.
  [[nodiscard]] const std::vector<int>& by_period() const { return by_period_; }

  struct Value {
    double largest = 0, sum = 0;  ///< as Figures', of the chains' ends as they are planned
    int last = -1;                ///< the component that the largest ends in
  };
  /// Where XNodes may go, as far as there is such an XPU for them.
  struct Where {
    bool apart =
        false;  ///< each domain has XPUs of its own: nothing is known of the phase to another one
    bool free = false;  ///< where preemption costs nothing
  };
  /// Of all components in this order. `hold`: [xnode] it does not begin before, after its release.
  Value plan(const std::vector<int>& order, const std::vector<Tick>& hold, const Where& where);
  [[nodiscard]] const std::vector<int>& xpu() const { return xpu_; }   ///< [xnode]
  [[nodiscard]] const std::vector<Tick>& key() const { return key_; }  ///< [xnode]

 private:
  /// What an XPU is busy with, apart from each other.
  struct Busy {
    Tick begin, end;
  };
  /// When work that is ready at `from` would end there.
  [[nodiscard]] Tick end_of(int xpu, Tick from, Tick work) const;
  void take(int xpu, Tick from, Tick work);
  [[nodiscard]] bool splits(int xpu) const;
  void share_out(int type, std::vector<char>& owns, std::vector<char>& served) const;
  void place(int xnode);
  void place_all(const std::vector<int>& xnodes);

  const Problem& p_;
  std::vector<std::vector<int>> on_chain_,
      rest_;                  ///< [component] XNodes, who has the longest way left first
  std::vector<double> rate_;  ///< [xnode * xpus + xpu] of the XPU's time
  std::vector<Tick> tail_;    ///< [xnode]
  std::vector<int> by_weight_, by_period_;
  Tick horizon_ = 0;

  std::vector<char> owns_, owns_free_;   ///< [domain * xpus + xpu]; of Where::free
  std::vector<std::vector<Busy>> busy_;  ///< [xpu]
  std::vector<double> load_;             ///< [xpu]
  std::vector<int> xpu_;
  std::vector<Tick> end_, key_;  ///< [xnode]
  const std::vector<Tick>* hold_ = nullptr;
  Where where_;
};

}  // namespace xauto::solver::keys

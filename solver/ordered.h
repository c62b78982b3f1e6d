// SPDX-License-Identifier: Apache-2.0
// OrderedEvaluator: the makespan of schedules in which every XPU runs its XNodes in a fixed order,
// one after the other, idle where it must (PriorityPlan::order). Its interface is that of Evaluator
// (evaluate.h), so that one annealer serves both.
//
// The makespan is the longest path of the precedence graph plus the order of each XPU. All times in
// it only grow with the WCETs, which is what makes such a schedule free of timing anomalies: the
// latency is its own certified worst case. No XNode is ever preempted, so preemption costs and
// non-preemptive XPUs make no difference.
//
// The sequence is kept a linear extension of the precedence graph; only the order within each XPU
// counts. Threads: one owner. Units: microseconds.
#pragma once

#include <cstdint>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

/// What lies around a part of a schedule, all else being kept as it is: microseconds from any one
/// instant on, and to any other.
struct Surroundings {
  std::vector<Time> free_at;   ///< [xpu] it is free from then on
  std::vector<Time> released;  ///< [xnode] its last predecessor outside the part ends
  std::vector<Time> behind;    ///< [xnode] from its end to that of all, past successors outside
  std::vector<Time> after;     ///< [xpu] from the end of its last XNode of the part to that of all
};

class OrderedEvaluator {
 public:
  /// The makespan is that of all of a schedule of which `problem` is a part, if `around` is given.
  explicit OrderedEvaluator(const Problem& problem, const Surroundings* around = nullptr);

  /// `sequence`: any permutation; it is repaired into a linear extension, keeping its order where
  /// possible.
  void reset(const std::vector<int>& xpu, const std::vector<int>& sequence);
  void assign(int xnode, int xpu);
  /// Moves `xnode` towards `position`, as far as the precedence graph allows.
  void reposition(int xnode, int position);
  [[nodiscard]] Time evaluate(Time limit);
  void commit();
  void rollback();

  [[nodiscard]] Time makespan() const { return makespan_; }
  [[nodiscard]] const std::vector<int>& xpu() const { return xpu_; }
  [[nodiscard]] const std::vector<int>& sequence() const { return sequence_; }
  [[nodiscard]] int position(int xnode) const { return position_[static_cast<std::size_t>(xnode)]; }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  void critical_chain(std::vector<int>& chain) const;

 private:
  void begin_edit();

  const Problem& problem_;
  std::size_t n_, m_;
  Surroundings around_;
  std::vector<int> xpu_, sequence_, position_;
  std::vector<Time> start_, finish_;  // of the committed schedule
  std::vector<Time> try_finish_, free_at_, tail_;
  std::vector<int> old_sequence_, old_xpu_;
  bool edited_ = false;
  int first_ = 0;  // of the sequence that differs from the committed one
  Time makespan_ = 0;
  std::int64_t evaluations_ = 0;
};

}  // namespace xauto::solver

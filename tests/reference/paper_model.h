// SPDX-License-Identifier: Apache-2.0
// The paper's model, equations 1-6, whole: docs/ilp.md has every row in its notation. solver/ilp.cc solves it window by
// window; tests hold it against this.
#pragma once

#include <vector>

#include "base/index.h"
#include "solver/ilp_model.h"
#include "solver/problem.h"

namespace xauto::solver {

/// n^3 m rows: 1.3 million for 60 XNodes on `small`.
class PaperModel {
 public:
  PaperModel(const Problem& problem, Time horizon);

  IlpModel& model() { return model_; }
  void bound_makespan(Time low, Time high);
  /// Scaled back; the model's makespans are whole microseconds but for rounding.
  [[nodiscard]] Time makespan() const;

 private:
  using Term = IlpModel::Term;

  [[nodiscard]] int p(int i, int m) const { return p_column_[at(i) * at(p_.num_xpus) + at(m)]; }
  [[nodiscard]] double w(int i, int m) const {
    return static_cast<double>(p_.wcet_on(i, m)) / unit_;
  }
  [[nodiscard]] bool before(int i, int j) const { return reaches_[at(i)][at(j)] != 0; }
  [[nodiscard]] bool can(int i, int m) const { return p(i, m) > 0; }

  void columns();
  void equation_1();
  void equation_2();
  /// Exactly one p_i^m is 1, so the conditions of all m join in one row, tighter than a big M each.
  void equation_3();
  /// Of instances that nothing tells apart, neither their properties nor who may run there, the
  /// r-th is open to an XNode only if an XNode ahead of it (in topological order) has the (r-1)-th.
  void symmetry();
  [[nodiscard]] bool open_alike(int x, int y) const;
  /// a_ik = 1 if s_i <= s_k; b_kj = 1 if f_k <= f_j; c_ij = 1 if s_i <= f_j. Times are whole
  /// microseconds (docs/ilp.md), so "not" is a difference of at least one. 0: fixed to 0; -1: fixed
  /// to 1.
  void ordering();
  void equations_4_and_5();
  void equation_6();
  /// Not in the paper, implied by it: the relaxation is nearly empty without them. What has a head
  /// >= h and a tail >= q and is on m fits there between h and T - q; of two XNodes one starts
  /// (ends) no later.
  void cuts();

  const Problem& p_;
  const double unit_, one_;  ///< microseconds per model unit; one microsecond in model units
  const Time horizon_;
  std::vector<std::vector<char>> reaches_;
  IlpModel model_;
  int makespan_ = 0;
  std::vector<int> s_, f_, p_column_, a_, b_, c_;
};

}  // namespace xauto::solver

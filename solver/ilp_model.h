// SPDX-License-Identifier: Apache-2.0
// A thin owner of one lp_solve model: columns and rows, minimise columns, end on time.
// Private to ilp*.cc.
#pragma once

#include <atomic>
#include <chrono>
#include <vector>

#include "solver/until.h"

// lp_solve's header drags macros along (TRUE, EQ, ...); it stays in ilp_model.cc.
struct _lprec;

namespace xauto::solver {

/// The unit of time in a model: a thousandth of the horizon, so that the big-M rows stay far from
/// lp_solve's tolerances whatever the app's times are.
inline constexpr double kHorizon = 1000;

class IlpModel {
 public:
  enum class Outcome { kOptimal, kFeasible, kInfeasible, kTimeLimit, kStopped, kFailed };
  struct Term {
    int column;
    double factor;
  };

  IlpModel();
  ~IlpModel();
  IlpModel(const IlpModel&) = delete;
  IlpModel& operator=(const IlpModel&) = delete;

  /// Continuous, within [low, high].
  int add_column(double low, double high);
  int add_binary();
  /// sum of terms >= right / <= right / = right.
  void at_least(const std::vector<Term>& terms, double right);
  void at_most(const std::vector<Term>& terms, double right);
  void equal(const std::vector<Term>& terms, double right);
  void set_range(int column, double low, double high);
  void minimise(int column);
  void minimise(const std::vector<Term>& terms);  ///< each column once

  [[nodiscard]] Outcome solve(double time_limit_s, const std::atomic<bool>* stop);
  /// The relaxation, from the last basis on where there is one. True: values and basis are its optimum's.
  [[nodiscard]] bool solve_relaxed(const Until& until);
  /// Which rows have slack in the basis, and which columns are in it; each [row or column - 1]. lp_solve's own multipliers
  /// are not to be had: asked for, it crashes where a solve is aborted.
  struct Basis {
    std::vector<char> slack, column;
  };
  [[nodiscard]] Basis basis() const;
  [[nodiscard]] double value(int column) const {
    return values_[static_cast<std::size_t>(column - 1)];
  }

 private:
  void abort_at(std::chrono::steady_clock::time_point deadline, const std::atomic<bool>* stop);
  void add_row(const std::vector<Term>& terms, int type, double right);

  _lprec* lp_;
  int columns_ = 0;
  std::vector<double> values_;
  const std::atomic<bool>* stop_ = nullptr;
  std::chrono::steady_clock::time_point deadline_;
  bool out_of_time_ = false, stopped_ = false;
  std::vector<int> scratch_columns_;
  std::vector<double> scratch_factors_;

  static int asked_to_stop(_lprec*, void* self);
};

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
#include "solver/ilp_model.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <lpsolve/lp_lib.h>

#include "base/index.h"

namespace xauto::solver {
IlpModel::IlpModel() : lp_(make_lp(0, 0)) {
  set_verbose(lp_, NEUTRAL);
  set_add_rowmode(lp_, FALSE);
}

IlpModel::~IlpModel() {
  delete_lp(lp_);
}

int IlpModel::add_column(double low, double high) {
  REAL value = 0;
  int row = 0;
  add_columnex(lp_, 0, &value, &row);
  ++columns_;
  set_bounds(lp_, columns_, low, high);
  return columns_;
}

int IlpModel::add_binary() {
  const int column = add_column(0, 1);
  set_int(lp_, column, TRUE);
  return column;
}

void IlpModel::set_range(int column, double low, double high) {
  set_bounds(lp_, column, low, high);
}

void IlpModel::at_least(const std::vector<Term>& terms, double right) {
  add_row(terms, GE, right);
}
void IlpModel::at_most(const std::vector<Term>& terms, double right) {
  add_row(terms, LE, right);
}
void IlpModel::equal(const std::vector<Term>& terms, double right) {
  add_row(terms, EQ, right);
}

void IlpModel::add_row(const std::vector<Term>& terms, int type, double right) {
  // One column may come twice (i = k in equation 4): lp_solve wants it once.
  std::vector<Term> sorted = terms;
  std::sort(sorted.begin(), sorted.end(),
            [](const Term& a, const Term& b) { return a.column < b.column; });
  scratch_columns_.clear();
  scratch_factors_.clear();
  for (const Term& term : sorted) {
    if (!scratch_columns_.empty() && scratch_columns_.back() == term.column) {
      scratch_factors_.back() += term.factor;
    } else {
      scratch_columns_.push_back(term.column);
      scratch_factors_.push_back(term.factor);
    }
  }
  add_constraintex(lp_, static_cast<int>(scratch_columns_.size()), scratch_factors_.data(),
                   scratch_columns_.data(), type, right);
}

void IlpModel::minimise(int column) {
  minimise({{column, 1}});
}

void IlpModel::minimise(const std::vector<Term>& terms) {
  scratch_columns_.clear();
  scratch_factors_.clear();
  for (const Term& term : terms) {
    scratch_columns_.push_back(term.column);
    scratch_factors_.push_back(term.factor);
  }
  set_obj_fnex(lp_, static_cast<int>(terms.size()), scratch_factors_.data(),
               scratch_columns_.data());
  set_minim(lp_);
}

int IlpModel::asked_to_stop(_lprec*, void* self) {
  auto* model = static_cast<IlpModel*>(self);
  if (model->stop_ != nullptr && model->stop_->load(std::memory_order_relaxed))
    model->stopped_ = true;
  if (std::chrono::steady_clock::now() >= model->deadline_) model->out_of_time_ = true;
  return model->stopped_ || model->out_of_time_ ? TRUE : FALSE;
}

void IlpModel::abort_at(std::chrono::steady_clock::time_point deadline,
                        const std::atomic<bool>* stop) {
  stop_ = stop;
  stopped_ = out_of_time_ = false;
  deadline_ = deadline;
  put_abortfunc(lp_, &IlpModel::asked_to_stop, this);
}

bool IlpModel::solve_relaxed(const Until& until) {
  abort_at(until.deadline, until.stop);
  if (::solve(lp_) != OPTIMAL) return false;
  values_.resize(at(columns_));
  get_variables(lp_, values_.data());
  return true;
}

IlpModel::Basis IlpModel::basis() const {
  const int rows = get_Nrows(lp_);
  Basis basis{std::vector<char>(at(rows), 0), std::vector<char>(at(columns_), 0)};
  std::vector<int> variables(at(rows) + 1, 0);
  if (get_basis(lp_, variables.data(), FALSE) == FALSE) return basis;
  for (int k = 1; k <= rows; ++k) {
    const int variable = std::abs(variables[at(k)]);
    if (variable == 0) continue;
    (variable <= rows ? basis.slack[at(variable - 1)] : basis.column[at(variable - rows - 1)]) = 1;
  }
  return basis;
}

IlpModel::Outcome IlpModel::solve(double time_limit_s, const std::atomic<bool>* stop) {
  abort_at(std::chrono::steady_clock::now() + std::chrono::microseconds(static_cast<std::int64_t>(
                                                  std::clamp(time_limit_s, 0.0, 1e7) * 1e6)),
           stop);
  // Whole seconds are all that set_timeout knows; the callback is precise, the timeout is the net
  // below it.
  set_timeout(lp_, static_cast<long>(std::ceil(std::clamp(time_limit_s, 0.0, 1e7))) + 1);
  set_bb_floorfirst(lp_, BRANCH_CEILING);
  set_bb_rule(lp_, NODE_FIRSTSELECT);
  default_basis(lp_);
  const int status = ::solve(lp_);
  const bool has_values = status == OPTIMAL || status == SUBOPTIMAL || status == PRESOLVED ||
                          (status == USERABORT && get_solutioncount(lp_) > 0);
  if (has_values) {
    values_.resize(at(columns_));
    get_variables(lp_, values_.data());
  }
  switch (status) {
    case OPTIMAL:
    case PRESOLVED:
      return out_of_time_ || stopped_ ? Outcome::kFeasible : Outcome::kOptimal;
    case SUBOPTIMAL:
      return Outcome::kFeasible;
    case INFEASIBLE:
      return stopped_       ? Outcome::kStopped
             : out_of_time_ ? Outcome::kTimeLimit
                            : Outcome::kInfeasible;
    case TIMEOUT:
      return Outcome::kTimeLimit;
    case USERABORT:
      return has_values ? Outcome::kFeasible : stopped_ ? Outcome::kStopped : Outcome::kTimeLimit;
    default:
      return stopped_ ? Outcome::kStopped : out_of_time_ ? Outcome::kTimeLimit : Outcome::kFailed;
  }
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// Times are scaled so that the horizon is 1000: big-M rows and lp_solve's tolerances (1e-9 on rows, 1e-7 on integers)
// then mean well below a microsecond.
#include "reference/paper_model.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "solver/bounds.h"

namespace xauto::solver {
PaperModel::PaperModel(const Problem& problem, Time horizon)
    : p_(problem),
      unit_(static_cast<double>(horizon) / kHorizon),
      one_(1 / unit_),
      horizon_(horizon),
      reaches_(at(problem.num_xnodes), std::vector<char>(at(problem.num_xnodes), 0)) {
  for (auto it = p_.topo.rbegin(); it != p_.topo.rend(); ++it)
    for (const int s : p_.succ[at(*it)]) {
      reaches_[at(*it)][at(s)] = 1;
      for (int k = 0; k < p_.num_xnodes; ++k)
        if (reaches_[at(s)][at(k)]) reaches_[at(*it)][at(k)] = 1;
    }
  columns();
  equation_1();
  equation_2();
  equation_3();
  symmetry();
  ordering();
  equations_4_and_5();
  equation_6();
  cuts();
}

void PaperModel::bound_makespan(Time low, Time high) {
  model_.set_range(makespan_, static_cast<double>(low) / unit_, static_cast<double>(high) / unit_);
}

Time PaperModel::makespan() const {
  return static_cast<Time>(std::ceil(model_.value(makespan_) * unit_ - 0.05));
}

void PaperModel::columns() {
  makespan_ = model_.add_column(0, kHorizon);
  const std::vector<Time> heads = static_heads(p_), tails = static_tails(p_),
                          least = least_wcet(p_);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const auto head = static_cast<double>(heads[at(i)]), tail = static_cast<double>(tails[at(i)]);
    const auto shortest = static_cast<double>(least[at(i)]);
    const double limit = static_cast<double>(horizon_);
    s_.push_back(model_.add_column(head / unit_, (limit - tail - shortest) / unit_));
    f_.push_back(model_.add_column((head + shortest) / unit_, (limit - tail) / unit_));
  }
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (int m = 0; m < p_.num_xpus; ++m)
      p_column_.push_back(p_.wcet_on(i, m) == kCannotRun ? 0 : model_.add_binary());
}

void PaperModel::equation_1() {
  for (int i = 0; i < p_.num_xnodes; ++i) {
    std::vector<Term> row;
    for (int m = 0; m < p_.num_xpus; ++m)
      if (can(i, m)) row.push_back({p(i, m), 1});
    model_.equal(row, 1);
  }
}

void PaperModel::equation_2() {
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (const int j : p_.pred[at(i)]) model_.at_least({{s_[at(i)], 1}, {f_[at(j)], -1}}, 0);
}

void PaperModel::equation_3() {
  for (int i = 0; i < p_.num_xnodes; ++i) {
    std::vector<Term> row = {{f_[at(i)], 1}, {s_[at(i)], -1}};
    for (int m = 0; m < p_.num_xpus; ++m)
      if (can(i, m)) row.push_back({p(i, m), -w(i, m)});
    model_.at_least(row, 0);
  }
}

void PaperModel::symmetry() {
  for (int m = 1; m < p_.num_xpus; ++m) {
    if (p_.xpu_type[at(m)] != p_.xpu_type[at(m - 1)] ||
        p_.preemptive[at(m)] != p_.preemptive[at(m - 1)] ||
        p_.preempt[at(m)] != p_.preempt[at(m - 1)] || p_.levels[at(m)] != p_.levels[at(m - 1)] ||
        !open_alike(m - 1, m))
      continue;
    std::vector<Term> ahead;
    for (const int i : p_.topo) {
      if (!can(i, m)) continue;
      std::vector<Term> row = ahead;
      row.push_back({p(i, m), -1});
      model_.at_least(row, 0);
      ahead.push_back({p(i, m - 1), 1});
    }
  }
}

bool PaperModel::open_alike(int x, int y) const {
  for (int i = 0; i < p_.num_xnodes; ++i)
    if (p_.wcet_on(i, x) != p_.wcet_on(i, y)) return false;
  return true;
}

void PaperModel::ordering() {
  const int n = p_.num_xnodes;
  a_.assign(at(n) * at(n), -1);
  b_ = c_ = a_;
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < n; ++k) {
      if (i == k) continue;
      const std::size_t cell = at(i) * at(n) + at(k);
      if (before(i, k)) continue;  // s_i < s_k, f_i < f_k, s_i < f_k
      if (before(k, i)) {
        a_[cell] = b_[cell] = c_[cell] = 0;
        continue;
      }
      a_[cell] = model_.add_binary();
      model_.at_least({{s_[at(i)], 1}, {s_[at(k)], -1}, {a_[cell], kHorizon + one_}}, one_);
      b_[cell] = model_.add_binary();
      model_.at_least({{f_[at(i)], 1}, {f_[at(k)], -1}, {b_[cell], kHorizon + one_}}, one_);
      c_[cell] = model_.add_binary();
      model_.at_least({{s_[at(i)], 1}, {f_[at(k)], -1}, {c_[cell], kHorizon + one_}}, one_);
      // s_i <= s_k implies s_i <= f_k.
      model_.at_least({{c_[cell], 1}, {a_[cell], -1}}, 0);
    }
}

void PaperModel::equations_4_and_5() {
  const int n = p_.num_xnodes;
  for (int m = 0; m < p_.num_xpus; ++m)
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < n; ++j) {
        const std::size_t ij = at(i) * at(n) + at(j);
        if (!can(i, m) || !can(j, m) || c_[ij] == 0) continue;
        std::vector<Term> capacity = {{f_[at(j)], -1}, {s_[at(i)], 1}};
        for (int k = 0; k < n; ++k) {
          const int a = a_[at(i) * at(n) + at(k)], b = b_[at(k) * at(n) + at(j)];
          if (!can(k, m) || a == 0 || b == 0) continue;
          // d >= wcet_k (p_i + p_j + p_k + a_ik + b_kj - 4); what is fixed to 1 or equal drops
          // out.
          const int d = model_.add_column(0, kHorizon);
          std::vector<Term> row = {{d, 1}};
          double ones = 0;
          const auto when = [&](int column) {
            row.push_back({column, -w(k, m)});
            ones += 1;
          };
          when(p(i, m));
          if (j != i) when(p(j, m));
          if (k != i && k != j) when(p(k, m));
          if (a > 0) when(a);
          if (b > 0) when(b);
          model_.at_least(row, -w(k, m) * (ones - 1));
          capacity.push_back({d, 1});
        }
        // sum d <= f_j - s_i where i and j are on m and s_i <= f_j; a big M for each that fails.
        double right = 0;
        const auto unless = [&](int column) {
          capacity.push_back({column, kHorizon});
          right += kHorizon;
        };
        unless(p(i, m));
        if (j != i) unless(p(j, m));
        if (c_[ij] > 0) unless(c_[ij]);
        model_.at_most(capacity, right);
      }
}

void PaperModel::equation_6() {
  const std::vector<Time> tails = static_tails(p_);
  for (int i = 0; i < p_.num_xnodes; ++i)
    model_.at_least(
        {{makespan_, 1}, {f_[at(i)], -1}},
        static_cast<double>(tails[at(i)]) / unit_);  // 0 in the paper; no solution is lost
  model_.minimise(makespan_);
}

void PaperModel::cuts() {
  const std::vector<Time> heads = static_heads(p_), tails = static_tails(p_);
  for (int m = 0; m < p_.num_xpus; ++m) {
    std::set<std::vector<int>> seen;
    for (int i = 0; i < p_.num_xnodes; ++i)
      for (int j = 0; j < p_.num_xnodes; ++j) {
        std::vector<int> members;
        for (int k = 0; k < p_.num_xnodes; ++k)
          if (can(k, m) && heads[at(k)] >= heads[at(i)] && tails[at(k)] >= tails[at(j)])
            members.push_back(k);
        if (members.size() < 2 || !seen.insert(members).second) continue;
        std::vector<Term> row = {{makespan_, 1}};
        Time h = horizon_, q = horizon_;
        for (const int k : members) {
          row.push_back({p(k, m), -w(k, m)});
          h = std::min(h, heads[at(k)]);
          q = std::min(q, tails[at(k)]);
        }
        model_.at_least(row, static_cast<double>(h + q) / unit_);
      }
  }
  const int n = p_.num_xnodes;
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < i; ++k) {
      const std::size_t ik = at(i) * at(n) + at(k), ki = at(k) * at(n) + at(i);
      if (a_[ik] <= 0 || a_[ki] <= 0) continue;
      model_.at_least({{a_[ik], 1}, {a_[ki], 1}}, 1);
      model_.at_least({{b_[ik], 1}, {b_[ki], 1}}, 1);
    }
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// See energy_lp.h.
#include "solver/energy_lp.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/index.h"
#include "solver/evaluate.h"

namespace xauto::solver {
namespace {

constexpr double kEpsilon = 1e-9;
constexpr int kMaxPivots = 600;        // plus four per column
constexpr std::size_t kMaxEdges = 48;  // window ends tried per type; beyond, an even sample of them
constexpr std::size_t kMaxRows = 160;

void sort_and_thin(std::vector<Time>& times) {
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());
  if (times.size() <= kMaxEdges) return;
  std::vector<Time> sample;
  for (std::size_t k = 0; k < kMaxEdges; ++k)
    sample.push_back(times[k * (times.size() - 1) / (kMaxEdges - 1)]);
  times = std::move(sample);
}

}  // namespace

EnergyLp::EnergyLp(const Problem& problem, std::function<bool()> stop)
    : problem_(problem), stop_(std::move(stop)), n_(problem.num_xnodes), types_(problem.num_types) {
  share_.assign(at(n_ * types_), 0);
  var_of_.assign(at(n_ * types_), -1);
  base_.assign(at(n_), 0);
}

Time EnergyLp::energy(const Windows& windows, std::size_t i, int type, Time a, Time b) const {
  const Time work = problem_.wcet(static_cast<int>(i), type) + windows.paid[i];
  const Time inside =
      work - std::max<Time>(0, a - windows.r[i]) - std::max<Time>(0, windows.d[i] - b);
  return std::max<Time>(0, std::min(b - a, inside));
}

void EnergyLp::start(const Windows& windows) {
  var_xnode_.clear();
  var_type_.clear();
  std::fill(var_of_.begin(), var_of_.end(), -1);
  for (int i = 0; i < n_; ++i) {
    const std::uint32_t mask = windows.types[at(i)];
    int base = -1;
    for (int t = 0; t < types_; ++t)
      if ((mask >> t & 1u) != 0 && (base < 0 || problem_.wcet(i, t) < problem_.wcet(i, base)))
        base = t;
    base_[at(i)] = base;
    for (int t = 0; t < types_; ++t) {
      if ((mask >> t & 1u) == 0 || t == base) continue;
      var_of_[at(i * types_ + t)] = static_cast<int>(var_xnode_.size());
      var_xnode_.push_back(i);
      var_type_.push_back(t);
    }
  }
  columns_ = var_xnode_.size();
  stride_ = columns_;
  tableau_.clear();
  rhs_.clear();
  rows_.clear();
  row_var_.clear();
  column_var_.resize(columns_);
  cost_.resize(columns_);
  for (std::size_t j = 0; j < columns_; ++j) {
    column_var_[j] = static_cast<int>(j);
    // Any costs >= 0 will do; different ones keep the dual simplex from cycling.
    cost_[j] = 1.0 + static_cast<double>((j * 2654435761u) % 1024u) / 1024.0;
  }
}

void EnergyLp::add_row(const Windows& windows, const Row& row) {
  const std::size_t structurals = columns_;  // as many columns as structurals, always
  std::vector<double> coefficient(structurals, 0);
  double rhs = 0;
  if (row.type < 0) {
    rhs = 1;
    for (int t = 0; t < types_; ++t) {
      const int v = var_of_[static_cast<std::size_t>(row.a * types_ + t)];
      if (v >= 0) coefficient[at(v)] = 1;
    }
  } else {
    const auto length = static_cast<double>(row.b - row.a);
    // Scaled to the window's length, so that tolerances mean the same in every row.
    rhs = static_cast<double>(problem_.type_xpus[at(row.type)].size());
    for (std::size_t i = 0; i < at(n_); ++i) {
      if ((windows.types[i] >> row.type & 1u) == 0) continue;
      const double e = static_cast<double>(energy(windows, i, row.type, row.a, row.b)) / length;
      if (e == 0) continue;
      if (base_[i] == row.type) {
        rhs -= e;
        for (int t = 0; t < types_; ++t) {
          const int v = var_of_[i * at(types_) + at(t)];
          if (v >= 0) coefficient[at(v)] -= e;
        }
      } else {
        coefficient[at(var_of_[i * at(types_) + at(row.type)])] += e;
      }
    }
  }
  // In terms of the present nonbasic variables.
  const std::size_t k = rhs_.size();
  tableau_.resize((k + 1) * stride_, 0.0);
  double* cells = tableau_.data() + k * stride_;
  for (std::size_t j = 0; j < columns_; ++j)
    if (at(column_var_[j]) < structurals) cells[j] = coefficient[at(column_var_[j])];
  for (std::size_t q = 0; q < k; ++q) {
    if (at(row_var_[q]) >= structurals) continue;
    const double c = coefficient[at(row_var_[q])];
    if (c == 0) continue;
    rhs -= c * rhs_[q];
    const double* other = tableau_.data() + q * stride_;
    for (std::size_t j = 0; j < columns_; ++j) cells[j] -= c * other[j];
  }
  rhs_.push_back(rhs);
  row_var_.push_back(static_cast<int>(structurals + rows_.size()));
  rows_.push_back(row);
}

int EnergyLp::dual_simplex() {
  for (int pivot = 0; pivot < kMaxPivots + 4 * static_cast<int>(columns_); ++pivot) {
    if (pivot % 64 == 63 && stop_ && stop_()) return -1;
    std::size_t r = rhs_.size();
    double worst = -1e-7;
    for (std::size_t k = 0; k < rhs_.size(); ++k) {
      if (rhs_[k] < worst) {
        worst = rhs_[k];
        r = k;
      }
    }
    if (r == rhs_.size()) return 1;
    std::size_t c = columns_;
    double best_ratio = 0, best_size = 0;
    double* row = tableau_.data() + r * stride_;
    for (std::size_t j = 0; j < columns_; ++j) {
      if (row[j] >= -kEpsilon) continue;
      const double ratio = cost_[j] / -row[j];
      if (c == columns_ || ratio < best_ratio - 1e-12 ||
          (ratio <= best_ratio + 1e-12 && -row[j] > best_size)) {
        c = j;
        best_ratio = ratio;
        best_size = -row[j];
      }
    }
    if (c == columns_) {
      bad_row_ = r;
      return 0;
    }
    // Pivot: the basic variable of row r and the nonbasic one of column c change places.
    const double inverse = 1.0 / row[c];
    for (std::size_t j = 0; j < columns_; ++j) row[j] *= inverse;
    row[c] = inverse;
    rhs_[r] *= inverse;
    for (std::size_t k = 0; k < rhs_.size(); ++k) {
      if (k == r) continue;
      double* other = tableau_.data() + k * stride_;
      const double factor = other[c];
      if (factor == 0) continue;
      other[c] = 0;
      for (std::size_t j = 0; j < columns_; ++j) other[j] -= factor * row[j];
      rhs_[k] -= factor * rhs_[r];
    }
    const double factor = cost_[c];
    cost_[c] = 0;
    for (std::size_t j = 0; j < columns_; ++j) cost_[j] -= factor * row[j];
    for (std::size_t j = 0; j < columns_; ++j) cost_[j] = std::max(0.0, cost_[j]);
    std::swap(row_var_[r], column_var_[c]);
  }
  return -1;
}

void EnergyLp::read_shares(const Windows& windows) {
  const std::size_t structurals = columns_;
  std::fill(share_.begin(), share_.end(), 0.0);
  for (std::size_t k = 0; k < rhs_.size(); ++k) {
    const std::size_t v = at(row_var_[k]);
    if (v < structurals) share_[at(var_xnode_[v] * types_ + var_type_[v])] = std::max(0.0, rhs_[k]);
  }
  for (int i = 0; i < n_; ++i) {
    if (windows.types[at(i)] == 0) continue;
    double rest = 1;
    for (int t = 0; t < types_; ++t) rest -= share_[at(i * types_ + t)];
    share_[at(i * types_ + base_[at(i)])] += rest;
  }
}

int EnergyLp::separate(const Windows& windows) {
  int added = 0;
  for (int i = 0; i < n_; ++i) {
    if (share_[at(i * types_ + base_[at(i)])] < -1e-7) {
      add_row(windows, {-1, i, 0});
      ++added;
    }
  }
  if (added > 0) return added;
  struct Item {
    Time r, d, w;
    double x;
  };
  std::vector<Item> items;
  std::vector<Time> begins, ends;
  for (int t = 0; t < types_; ++t) {
    items.clear();
    begins.clear();
    ends.clear();
    for (int i = 0; i < n_; ++i) {
      const double x = share_[at(i * types_ + t)];
      if (x < 1e-9) continue;
      items.push_back(
          {windows.r[at(i)], windows.d[at(i)], problem_.wcet(i, t) + windows.paid[at(i)], x});
      begins.push_back(windows.r[at(i)]);
      ends.push_back(windows.d[at(i)]);
    }
    const auto instances = static_cast<double>(problem_.type_xpus[at(t)].size());
    if (static_cast<double>(items.size()) <= instances) continue;
    sort_and_thin(begins);
    sort_and_thin(ends);
    // The two most violated windows with different beginnings.
    double best[2] = {1e-6, 1e-6};
    Row found[2] = {{-2, 0, 0}, {-2, 0, 0}};
    for (const Time a : begins) {
      double best_here = 1e-6;
      Row here{-2, 0, 0};
      for (const Time b : ends) {
        if (b <= a) continue;
        double sum = 0;
        for (const Item& item : items) {
          const Time inside = std::min(
              b - a, item.w - std::max<Time>(0, a - item.r) - std::max<Time>(0, item.d - b));
          if (inside > 0) sum += static_cast<double>(inside) * item.x;
        }
        const double violation = sum / static_cast<double>(b - a) - instances;
        if (violation > best_here) {
          best_here = violation;
          here = {t, a, b};
        }
      }
      if (here.type < 0) continue;
      if (best_here > best[0]) {
        best[1] = best[0];
        found[1] = found[0];
        best[0] = best_here;
        found[0] = here;
      } else if (best_here > best[1]) {
        best[1] = best_here;
        found[1] = here;
      }
    }
    for (const Row& row : found) {
      if (row.type < 0) continue;
      add_row(windows, row);
      ++added;
    }
  }
  return added;
}

bool EnergyLp::refutation_holds(const Windows& windows) {
  // Row bad_row_ says: its basic variable = negative - sum of non-negative terms. Its slacks'
  // coefficients are the multipliers of the rows that contradict each other.
  const std::size_t structurals = columns_;
  std::vector<double> y(rows_.size(), 0);
  if (at(row_var_[bad_row_]) >= structurals) y[at(row_var_[bad_row_]) - structurals] = 1;
  for (std::size_t j = 0; j < columns_; ++j) {
    const std::size_t v = at(column_var_[j]);
    if (v >= structurals) y[v - structurals] = std::max(0.0, cell(bad_row_, j));
  }
  double largest = 0;
  for (std::size_t k = 0; k < rows_.size(); ++k) {
    if (rows_[k].type < 0) y[k] = 0;  // implied below: each XNode takes its cheapest type
    // Back to unscaled rows.
    if (rows_[k].type >= 0) y[k] /= static_cast<double>(rows_[k].b - rows_[k].a);
    largest = std::max(largest, y[k]);
  }
  if (largest <= 0) return false;
  __int128 least = 0, capacity = 0;
  std::vector<std::int64_t> multiplier(rows_.size(), 0);
  for (std::size_t k = 0; k < rows_.size(); ++k) {
    multiplier[k] = std::llround(y[k] / largest * 0x1p30);
    if (multiplier[k] == 0) continue;
    capacity += static_cast<__int128>(multiplier[k]) * (rows_[k].b - rows_[k].a) *
                static_cast<std::int64_t>(problem_.type_xpus[at(rows_[k].type)].size());
    pool_.push_back(rows_[k]);
  }
  for (int i = 0; i < n_; ++i) {
    bool first = true;
    __int128 cheapest = 0;
    for (int t = 0; t < types_; ++t) {
      if ((windows.types[at(i)] >> t & 1u) == 0) continue;
      __int128 sum = 0;
      for (std::size_t k = 0; k < rows_.size(); ++k)
        if (rows_[k].type == t && multiplier[k] != 0)
          sum += static_cast<__int128>(multiplier[k]) *
                 energy(windows, at(i), t, rows_[k].a, rows_[k].b);
      if (first || sum < cheapest) cheapest = sum;
      first = false;
    }
    least += cheapest;
  }
  return least > capacity;
}

bool EnergyLp::feasible(const Windows& windows) {
  ++solved_;
  start(windows);
  if (pool_.size() > 40) pool_.erase(pool_.begin(), pool_.end() - 40);
  for (const Row& row : pool_) {
    const bool known = std::any_of(rows_.begin(), rows_.end(), [&](const Row& other) {
      return other.type == row.type && other.a == row.a && other.b == row.b;
    });
    if (!known) add_row(windows, row);
  }
  pool_.clear();
  while (true) {
    const int status = dual_simplex();
    if (status == 0) return !refutation_holds(windows);
    read_shares(windows);
    if (status < 0 || rows_.size() > kMaxRows || separate(windows) == 0) break;
  }
  const std::size_t structurals = columns_;
  for (std::size_t j = 0; j < columns_; ++j) {
    const int v = column_var_[j];
    if (at(v) >= structurals && rows_[at(v) - structurals].type >= 0)
      pool_.push_back(rows_[at(v) - structurals]);
  }
  return true;
}

}  // namespace xauto::solver

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
constexpr double kNearlyFull = 0.9;   // of all instances: such a window is looked at more closely
constexpr std::size_t kMostFull = 6;  // of these, by type

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

Time EnergyLp::coefficient(const Windows& windows, const Row& row, std::size_t i, int type) const {
  if (row.type == kChain) return problem_.wcet(static_cast<int>(i), type) + windows.extra[i];
  return packed(energy(windows, i, type, row.a, row.b), row.b - row.a, row.grain);
}

void EnergyLp::start(const Windows& windows) {
  var_xnode_.clear();
  var_type_.clear();
  std::fill(var_of_.begin(), var_of_.end(), -1);
  for (int i = 0; i < n_; ++i) {
    const TypeSet mask = windows.types[at(i)];
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
  if (row.type == kShares) {
    rhs = 1;
    for (int t = 0; t < types_; ++t) {
      const int v = var_of_[static_cast<std::size_t>(row.a * types_ + t)];
      if (v >= 0) coefficient[at(v)] = 1;
    }
  } else {
    // Scaled to the window's length, so that tolerances mean the same in every row.
    const auto length = static_cast<double>(std::max<Time>(1, row.room()));
    rhs = row.type == kChain ? static_cast<double>(row.b - row.a) / length
                             : static_cast<double>(problem_.type_xpus[at(row.type)].size());
    const auto add = [&](std::size_t i, int type) {
      const double e = static_cast<double>(this->coefficient(windows, row, i, type)) / length;
      if (e == 0) return;
      if (base_[i] == type) {
        rhs -= e;
        for (int t = 0; t < types_; ++t) {
          const int v = var_of_[i * at(types_) + at(t)];
          if (v >= 0) coefficient[at(v)] -= e;
        }
      } else {
        coefficient[at(var_of_[i * at(types_) + at(type)])] += e;
      }
    };
    if (row.type == kChain) {
      for (const int i : row.chain)
        for (TypeSet types = windows.types[at(i)]; types != 0; types &= types - 1)
          add(at(i), std::countr_zero(types));
    } else {
      for (std::size_t i = 0; i < at(n_); ++i)
        if ((windows.types[i] >> row.type & 1u) != 0) add(i, row.type);
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
      add_row(windows, {kShares, i, 0});
      ++added;
    }
  }
  if (added > 0) return added;
  added = separate_chains(windows);
  full_.resize(at(types_));
  for (auto& full : full_) full.clear();
  for (int t = 0; t < types_; ++t) added += separate_windows(windows, t);
  return added;
}

void EnergyLp::read_works(const Windows& windows, int type) {
  works_.clear();
  begins_.clear();
  ends_.clear();
  for (int i = 0; i < n_; ++i) {
    const double x = share_[at(i * types_ + type)];
    if (x < 1e-9) continue;
    works_.push_back(
        {windows.r[at(i)], windows.d[at(i)], problem_.wcet(i, type) + windows.paid[at(i)], x});
    begins_.push_back(windows.r[at(i)]);
    ends_.push_back(windows.d[at(i)]);
  }
}

void EnergyLp::read_slopes(Time a) {
  // What is left of an XNode at a begins to count once b is within it of the end that it may
  // have, and then with every microsecond of b, until all of it counts.
  slope_.assign(ends_.size() + 1, 0.0);
  level_.assign(ends_.size() + 1, 0.0);
  const auto first_end = [&](Time b) {
    return static_cast<std::size_t>(std::lower_bound(ends_.begin(), ends_.end(), b) -
                                    ends_.begin());
  };
  for (const Work& work : works_) {
    const Time left = work.w - std::max<Time>(0, a - work.r);
    if (left <= 0) continue;
    const Time from = std::max(a, work.d - left);
    const std::size_t grows = first_end(from), full = first_end(from + left);
    slope_[grows] += work.x;
    level_[grows] -= work.x * static_cast<double>(from - a);
    slope_[full] -= work.x;
    level_[full] += work.x * static_cast<double>(from + left - a);
  }
}

int EnergyLp::separate_windows(const Windows& windows, int type) {
  read_works(windows, type);
  const auto instances = static_cast<double>(problem_.type_xpus[at(type)].size());
  if (static_cast<double>(works_.size()) <= instances) return 0;
  sort_and_thin(begins_);
  sort_and_thin(ends_);
  // The two most violated windows with different beginnings.
  double best[2] = {1e-6, 1e-6};
  Row found[2] = {{kNone, 0, 0}, {kNone, 0, 0}};
  for (const Time a : begins_) {
    read_slopes(a);
    Full fullest{kNearlyFull * instances, a, a};
    double best_here = 1e-6, rate = 0, base = 0;
    Row here{kNone, 0, 0};
    for (std::size_t k = 0; k < ends_.size(); ++k) {
      rate += slope_[k];
      base += level_[k];
      const Time b = ends_[k];
      if (b <= a) continue;
      const auto length = static_cast<double>(b - a);
      const double used = (rate * length + base) / length, violation = used - instances;
      if (used > fullest.instances) fullest = {used, a, b};
      if (violation > best_here) {
        best_here = violation;
        here = {type, a, b};
      }
    }
    if (fullest.b > a) full_[at(type)].push_back(fullest);
    if (here.type == kNone) continue;
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
  int added = 0;
  for (const Row& row : found) {
    if (row.type == kNone) continue;
    add_row(windows, row);
    ++added;
  }
  return added;
}

int EnergyLp::separate_packing(const Windows& windows) {
  int added = 0;
  for (int t = 0; t < types_; ++t) {
    auto& full = full_[at(t)];
    const std::size_t tried = std::min(kMostFull, full.size());
    std::partial_sort(full.begin(), full.begin() + static_cast<std::ptrdiff_t>(tried), full.end(),
                      [](const Full& p, const Full& q) { return p.instances > q.instances; });
    const auto instances = static_cast<double>(problem_.type_xpus[at(t)].size());
    double most = 1e-3;
    Row found{kNone, 0, 0};
    for (std::size_t k = 0; k < tried; ++k) {
      const Time a = full[k].a, b = full[k].b;
      packing_.clear();
      for (std::size_t i = 0; i < at(n_); ++i) {
        const double x = share(static_cast<int>(i), t);
        if (x < 1e-9) continue;
        const Time work = energy(windows, i, t, a, b);
        if (work > 0) packing_.add(work, x);
      }
      Time grain = 0;
      const double excess = packing_.excess(b - a, instances, grain);
      if (excess <= most) continue;
      most = excess;
      found = {t, a, b, grain};
    }
    if (found.type == kNone) continue;
    add_row(windows, found);
    ++added;
  }
  return added;
}

int EnergyLp::separate_chains(const Windows& windows) {
  spans_.assign(at(n_), 0);
  heads_.assign(at(n_), 0);
  before_.assign(at(n_), -1);
  for (std::size_t i = 0; i < at(n_); ++i) {
    double span = static_cast<double>(windows.extra[i]);
    for (TypeSet types = windows.types[i]; types != 0; types &= types - 1) {
      const int t = std::countr_zero(types);
      span += share(static_cast<int>(i), t) *
              static_cast<double>(problem_.wcet(static_cast<int>(i), t));
    }
    spans_[i] = span;
  }
  int latest = -1;
  double most = 0;
  for (const int i : problem_.topo) {
    heads_[at(i)] = static_cast<double>(windows.r[at(i)]);
    for (const int p : problem_.pred[at(i)]) {
      const double end = heads_[at(p)] + spans_[at(p)];
      if (end <= heads_[at(i)]) continue;
      heads_[at(i)] = end;
      before_[at(i)] = p;
    }
    const double late = heads_[at(i)] + spans_[at(i)] - static_cast<double>(windows.d[at(i)]);
    if (late <= most) continue;
    most = late;
    latest = i;
  }
  if (latest < 0) return 0;
  Row row{kChain, 0, windows.d[at(latest)]};
  for (int i = latest; i >= 0; i = before_[at(i)]) row.chain.push_back(i);
  row.a = windows.r[at(row.chain.back())];
  if (most < 1e-6 * static_cast<double>(std::max<Time>(1, row.b - row.a))) return 0;
  add_row(windows, row);
  return 1;
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
    const Row& row = rows_[k];
    if (row.type == kShares) y[k] = 0;  // implied below: each XNode takes its cheapest type
    // Back to unscaled rows.
    y[k] /= static_cast<double>(std::max<Time>(1, row.room()));
    largest = std::max(largest, y[k]);
  }
  if (largest <= 0) return false;
  __int128 least = 0, capacity = 0;
  std::vector<__int128> sum(at(n_ * types_), 0);
  for (std::size_t k = 0; k < rows_.size(); ++k) {
    const std::int64_t multiplier = std::llround(y[k] / largest * 0x1p30);
    if (multiplier == 0) continue;
    const Row& row = rows_[k];
    const std::int64_t instances =
        row.type == kChain ? 1 : static_cast<std::int64_t>(problem_.type_xpus[at(row.type)].size());
    capacity += static_cast<__int128>(multiplier) * row.room() * instances;
    const auto add = [&](std::size_t i, int t) {
      sum[i * at(types_) + at(t)] +=
          static_cast<__int128>(multiplier) * coefficient(windows, row, i, t);
    };
    if (row.type == kChain) {
      for (const int i : row.chain)
        for (int t = 0; t < types_; ++t)
          if ((windows.types[at(i)] >> t & 1u) != 0) add(at(i), t);
    } else {
      for (std::size_t i = 0; i < at(n_); ++i)
        if ((windows.types[i] >> row.type & 1u) != 0) add(i, row.type);
    }
    pool_.push_back(row);
  }
  for (std::size_t i = 0; i < at(n_); ++i) {
    bool first = true;
    __int128 cheapest = 0;
    for (int t = 0; t < types_; ++t) {
      if ((windows.types[i] >> t & 1u) == 0) continue;
      const __int128 here = sum[i * at(types_) + at(t)];
      if (first || here < cheapest) cheapest = here;
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
  for (Row& row : pool_) {
    if (row.type == kChain) {
      row.a = windows.r[at(row.chain.back())];
      row.b = windows.d[at(row.chain.front())];
    }
    if (std::find(rows_.begin(), rows_.end(), row) == rows_.end()) add_row(windows, row);
  }
  pool_.clear();
  while (true) {
    const int status = dual_simplex();
    if (status == 0) return !refutation_holds(windows);
    read_shares(windows);
    if (status < 0 || rows_.size() > kMaxRows) break;
    if (separate(windows) == 0 && separate_packing(windows) == 0) break;
  }
  const std::size_t structurals = columns_;
  for (std::size_t j = 0; j < columns_; ++j) {
    const int v = column_var_[j];
    if (at(v) >= structurals && rows_[at(v) - structurals].type != kShares)
      pool_.push_back(rows_[at(v) - structurals]);
  }
  return true;
}

}  // namespace xauto::solver

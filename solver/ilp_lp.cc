// SPDX-License-Identifier: Apache-2.0
// See ilp_lp.h.
#include "solver/ilp_lp.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "base/index.h"

namespace xauto::solver {
namespace {

constexpr int kRounds = 20;  ///< of windows that are added to one LP; chosen
constexpr double kViolated =
    1e-4;  ///< of a model's unit, or of a window's length: what counts as that
constexpr double kCounts = 1e-7;   ///< a share from here on
constexpr double kBinding = 1e-3;  ///< units of a model that a window has left and still binds

}  // namespace

/// An LP in integers beside the one that lp_solve has, whose times are divided by `unit`.
struct IlpRelaxation::Lp {
  IlpModel model;
  double unit = 1;
  std::vector<Row> rows;
  std::vector<Time> low, high;  ///< [column]
  std::vector<char> is_time;    ///< [column] divided by `unit`
  std::vector<IlpWindow> windows;
  std::vector<int> s, f;   ///< [xnode] columns
  std::vector<int> share;  ///< [xnode * classes + class] columns; 0: none
  int excess = 0;

  int column(Time least, Time most, bool time) {
    low.push_back(least);
    high.push_back(most);
    is_time.push_back(time ? 1 : 0);
    const double by = time ? unit : 1;
    return model.add_column(static_cast<double>(least) / by, static_cast<double>(most) / by);
  }
  [[nodiscard]] double value(int column) const { return model.value(column); }
};

IlpRelaxation::IlpRelaxation(const Problem& problem, const IlpRanges& ranges)
    : p_(problem), ranges_(ranges) {}

/// Of a row in the model's units: a row of times has all its terms in them, one of shares alone none.
double IlpRelaxation::scaled(const Lp& lp, const Row& row, const std::pair<int, Time>& term) {
  const auto factor = static_cast<double>(term.second);
  return row.equal || lp.is_time[at(term.first - 1)] != 0 ? factor : factor / lp.unit;
}

void IlpRelaxation::add(Lp& lp, Row row) {
  std::vector<IlpModel::Term> terms;
  for (const auto& term : row.terms) terms.push_back({term.first, scaled(lp, row, term)});
  if (row.equal)
    lp.model.equal(terms, static_cast<double>(row.right));
  else
    lp.model.at_least(terms, static_cast<double>(row.right) / lp.unit);
  lp.rows.push_back(std::move(row));
}

void IlpRelaxation::add_columns(Lp& lp, const IlpNode& node) const {
  const Time horizon = std::max<Time>(1, *std::max_element(node.d.begin(), node.d.end()));
  lp.unit = static_cast<double>(horizon) / kHorizon;
  // By how much the latest finishes, and the room of windows, are exceeded: 0 in every schedule of the node.
  lp.excess = lp.column(0, 4 * horizon, true);
  const std::size_t classes = ranges_.classes().size();
  lp.share.assign(at(p_.num_xnodes) * classes, 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    lp.s.push_back(lp.column(node.r[at(i)], 4 * horizon, true));
    lp.f.push_back(lp.column(node.e[at(i)], 4 * horizon, true));
    for (std::size_t c = 0; c < classes; ++c)
      if ((node.classes[at(i)] >> c & 1U) != 0)
        lp.share[at(i) * classes + c] = lp.column(0, 1, false);
  }
  lp.model.minimise(lp.excess);
}

void IlpRelaxation::add_equations(Lp& lp, const IlpNode& node) const {
  const std::size_t classes = ranges_.classes().size();
  for (int i = 0; i < p_.num_xnodes; ++i) {
    Row one{{}, 1, true, -1}, takes{{{lp.f[at(i)], 1}, {lp.s[at(i)], -1}}, 0, false, -1};
    for (std::size_t c = 0; c < classes; ++c) {
      const int column = lp.share[at(i) * classes + c];
      if (column == 0) continue;
      one.terms.emplace_back(column, 1);
      takes.terms.emplace_back(column, -ranges_.wcet(i, static_cast<int>(c)));
    }
    add(lp, std::move(one));
    add(lp, std::move(takes));
    for (const int j : p_.pred[at(i)])
      add(lp, {{{lp.s[at(i)], 1}, {lp.f[at(j)], -1}}, 0, false, -1});
    add(lp, {{{lp.excess, 1}, {lp.f[at(i)], -1}}, -node.d[at(i)], false, -1});
  }
}

void IlpRelaxation::add_window(Lp& lp, const IlpNode& node, const IlpWindow& window) const {
  const std::size_t classes = ranges_.classes().size();
  const Time instances = static_cast<Time>(ranges_.classes()[at(window.of_class)].size());
  Row row{{}, 0, false, static_cast<int>(lp.windows.size())};
  const int first = static_cast<int>(window.a), last = static_cast<int>(window.b);
  if (window.of_xnodes) {
    row.terms = {{lp.f[at(last)], instances}, {lp.s[at(first)], -instances}};
  } else {
    row.terms = {{lp.excess, instances}};
    row.right = -instances * (window.b - window.a);
  }
  for (int k = 0; k < p_.num_xnodes; ++k) {
    const int column = lp.share[at(k) * classes + at(window.of_class)];
    if (column == 0) continue;
    Time work = 0;
    if (!window.of_xnodes)
      work = ranges_.energy(node, k, window.of_class, window.a, window.b);
    else if ((k == first || ranges_.before(first, k)) && (k == last || ranges_.before(k, last)))
      work = ranges_.wcet(k, window.of_class);
    if (work > 0) row.terms.emplace_back(column, -work);
  }
  lp.windows.push_back(window);
  add(lp, std::move(row));
}

void IlpRelaxation::violated_times(const Lp& lp, const IlpNode& node, int of_class,
                                   std::vector<IlpWindow>& found) const {
  const std::size_t classes = ranges_.classes().size();
  const auto instances = static_cast<double>(ranges_.classes()[at(of_class)].size());
  std::vector<std::pair<int, double>> on;
  std::vector<Time> begins, ends;
  for (int k = 0; k < p_.num_xnodes; ++k) {
    const int column = lp.share[at(k) * classes + at(of_class)];
    if (column == 0 || lp.value(column) < kCounts) continue;
    on.emplace_back(k, lp.value(column));
    begins.push_back(node.r[at(k)]);
    ends.push_back(node.d[at(k)]);
  }
  for (auto* times : {&begins, &ends}) {
    std::sort(times->begin(), times->end());
    times->erase(std::unique(times->begin(), times->end()), times->end());
  }
  const double excess = lp.value(lp.excess) * lp.unit;
  // The most violated one of each beginning; of these the two most violated ones.
  std::vector<std::pair<double, IlpWindow>> worst;
  for (const Time a : begins) {
    double most = kViolated;
    IlpWindow window{-1, false, a, a};
    for (const Time b : ends) {
      if (b <= a) continue;
      double energies = 0;
      for (const auto& [k, x] : on)
        energies += x * static_cast<double>(ranges_.energy(node, k, of_class, a, b));
      const double violation =
          (energies - instances * excess) / static_cast<double>(b - a) - instances;
      if (violation <= most) continue;
      most = violation;
      window = {of_class, false, a, b};
    }
    if (window.of_class >= 0) worst.emplace_back(most, window);
  }
  constexpr std::size_t kMost = 2;
  std::stable_sort(worst.begin(), worst.end(),
                   [](const auto& p, const auto& q) { return p.first > q.first; });
  for (std::size_t k = 0; k < std::min(kMost, worst.size()); ++k) found.push_back(worst[k].second);
}

void IlpRelaxation::violated_xnodes(const Lp& lp, int of_class,
                                    std::vector<IlpWindow>& found) const {
  const std::size_t classes = ranges_.classes().size();
  const auto instances = static_cast<double>(ranges_.classes()[at(of_class)].size());
  double most = kViolated * kHorizon / 100;
  IlpWindow worst{-1, true, 0, 0};
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (int j = 0; j < p_.num_xnodes; ++j) {
      if (!ranges_.before(i, j)) continue;
      double work = 0;
      for (int k = 0; k < p_.num_xnodes; ++k) {
        const int column = lp.share[at(k) * classes + at(of_class)];
        if (column == 0 || (k != i && !ranges_.before(i, k)) || (k != j && !ranges_.before(k, j)))
          continue;
        work += lp.value(column) * static_cast<double>(ranges_.wcet(k, of_class));
      }
      const double violation =
          work / lp.unit - instances * (lp.value(lp.f[at(j)]) - lp.value(lp.s[at(i)]));
      if (violation <= most) continue;
      most = violation;
      worst = {of_class, true, i, j};
    }
  if (worst.of_class >= 0) found.push_back(worst);
}

bool IlpRelaxation::separate(Lp& lp, const IlpNode& node) const {
  std::vector<IlpWindow> found;
  for (std::size_t c = 0; c < ranges_.classes().size(); ++c) {
    violated_times(lp, node, static_cast<int>(c), found);
    violated_xnodes(lp, static_cast<int>(c), found);
  }
  bool any = false;
  for (const IlpWindow& window : found) {
    if (std::find(lp.windows.begin(), lp.windows.end(), window) != lp.windows.end()) continue;
    add_window(lp, node, window);
    any = true;
  }
  return any;
}

/// [row] of the basis: those of rows with slack are 0, and the others give each column in it what it costs.
std::vector<double> IlpRelaxation::multipliers(const Lp& lp) {
  const IlpModel::Basis basis = lp.model.basis();
  std::vector<int> place(lp.low.size(), -1), tight;
  int columns = 0;
  for (std::size_t j = 0; j < place.size(); ++j)
    if (basis.column[j] != 0) place[j] = columns++;
  for (std::size_t k = 0; k < lp.rows.size(); ++k)
    if (basis.slack[k] == 0) tight.push_back(static_cast<int>(k));
  std::vector<double> y(lp.rows.size(), 0);
  if (columns != static_cast<int>(tight.size()) || place[at(lp.excess - 1)] < 0) return y;
  Eigen::MatrixXd factors = Eigen::MatrixXd::Zero(columns, columns);
  for (int k = 0; k < columns; ++k) {
    const Row& row = lp.rows[at(tight[at(k)])];
    for (const auto& term : row.terms)
      if (const int j = place[at(term.first - 1)]; j >= 0) factors(j, k) = scaled(lp, row, term);
  }
  const Eigen::VectorXd cost = Eigen::VectorXd::Unit(columns, place[at(lp.excess - 1)]);
  const Eigen::VectorXd found = factors.partialPivLu().solve(cost);
  for (int k = 0; k < columns; ++k) y[at(tight[at(k)])] = found(k);
  return y;
}

/// With multipliers y >= 0 (of equations any): excess >= sum of y right + the least that all columns add within their
/// ranges. Above 0 no schedule is in the node, whatever y is.
bool IlpRelaxation::holds_in_integers(const Lp& lp) {
  // Sums of as many products as there are then stay within 128 bits.
  const double one = std::min(0x1p24, std::exp2(std::floor(50 - std::log2(lp.unit * kHorizon))));
  const std::vector<double> y = multipliers(lp);
  std::vector<__int128> left(lp.low.size(), 0);
  left[at(lp.excess - 1)] = static_cast<__int128>(one);
  __int128 sum = 0;
  for (std::size_t k = 0; k < lp.rows.size(); ++k) {
    const Row& row = lp.rows[k];
    // What a share is worth is a time.
    const double scaled = y[k] * one * (row.equal ? lp.unit : 1);
    if (!std::isfinite(scaled) || std::abs(scaled) > 0x1p52) return false;
    const std::int64_t by = std::llround(row.equal ? scaled : std::max(0.0, scaled));
    if (by == 0) continue;
    sum += static_cast<__int128>(by) * row.right;
    for (const auto& [column, factor] : row.terms)
      left[at(column - 1)] -= static_cast<__int128>(by) * factor;
  }
  for (std::size_t j = 0; j < left.size(); ++j)
    sum += left[j] * (left[j] >= 0 ? lp.low[j] : lp.high[j]);
  return sum > 0;
}

bool IlpRelaxation::refuted(const IlpNode& node, std::vector<IlpWindow>& windows,
                            const Until& until) {
  Lp lp;
  add_columns(lp, node);
  add_equations(lp, node);
  for (const IlpWindow& window : windows) add_window(lp, node, window);
  const std::size_t classes = ranges_.classes().size();
  share_.assign(at(p_.num_xnodes) * classes, 0);
  bool solved = false;
  for (int round = 0; round < kRounds && !until.over(); ++round) {
    ++solved_;
    solved = lp.model.solve_relaxed(until);
    if (!solved) break;
    if (lp.value(lp.excess) > 0 && holds_in_integers(lp)) return true;
    for (std::size_t k = 0; k < share_.size(); ++k)
      share_[k] = lp.share[k] == 0 ? 0 : lp.value(lp.share[k]);
    if (!separate(lp, node)) break;
  }
  if (!solved) return false;
  windows.clear();
  for (const Row& row : lp.rows) {
    double left = -static_cast<double>(row.right);
    for (const auto& [column, factor] : row.terms)
      left += static_cast<double>(factor) * lp.value(column) *
              (lp.is_time[at(column - 1)] != 0 ? lp.unit : 1);
    if (row.window >= 0 && left < lp.unit * kBinding) windows.push_back(lp.windows[at(row.window)]);
  }
  return false;
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
#include "solver/choose_tables.h"

#include <algorithm>
#include <set>
#include <string>
#include <utility>

#include "base/index.h"
#include "solver/ilp_model.h"

namespace xauto::solver {
namespace {

using Regrets = std::vector<std::vector<double>>;

/// Another one serves within `regret` all that this one does; of equals the first stays.
bool dominated(const Regrets& of, std::size_t c, double regret) {
  for (std::size_t d = 0; d < of.size(); ++d) {
    if (d == c) continue;
    bool all = true, more = false;
    for (std::size_t s = 0; s < of[c].size() && all; ++s) {
      const bool mine = of[c][s] <= regret, its = of[d][s] <= regret;
      all = !mine || its;
      more = more || (its && !mine);
    }
    if (all && (more || d < c)) return true;
  }
  return false;
}

/// The least number of candidates that serve every scenario within `regret`, and which; empty: as
/// many as `most` do not.
std::vector<int> cover(const Regrets& of, double regret, int most, const std::atomic<bool>* stop) {
  IlpModel model;
  std::vector<IlpModel::Term> all;
  std::vector<int> column(of.size(), -1);
  for (std::size_t c = 0; c < of.size(); ++c) {
    const bool serves =
        std::any_of(of[c].begin(), of[c].end(), [&](double r) { return r <= regret; });
    if (!serves || dominated(of, c, regret)) continue;
    column[c] = model.add_binary();
    all.push_back({column[c], 1});
  }
  const int count = model.add_column(0, most);
  all.push_back({count, -1});
  model.equal(all, 0);
  for (std::size_t s = 0; s < of.front().size(); ++s) {
    std::vector<IlpModel::Term> serve;
    for (std::size_t c = 0; c < of.size(); ++c)
      if (column[c] >= 0 && of[c][s] <= regret) serve.push_back({column[c], 1});
    if (serve.empty()) return {};
    model.at_least(serve, 1);
  }
  model.minimise(count);
  constexpr double kSeconds = 2;  // chosen: what lp_solve has then is valid
  const IlpModel::Outcome outcome = model.solve(kSeconds, stop);
  if (outcome != IlpModel::Outcome::kOptimal && outcome != IlpModel::Outcome::kFeasible) return {};
  std::vector<int> chosen;
  for (std::size_t c = 0; c < of.size(); ++c)
    if (column[c] >= 0 && model.value(column[c]) > 0.5) chosen.push_back(static_cast<int>(c));
  return static_cast<int>(chosen.size()) <= most ? chosen : std::vector<int>();
}

/// Each scenario by the best of `chosen`.
TableChoice serve(const Regrets& regret, std::vector<int> chosen) {
  TableChoice choice;
  choice.worst = 0;
  for (std::size_t s = 0; s < regret.front().size(); ++s) {
    const int by = *std::min_element(chosen.begin(), chosen.end(), [&](int a, int b) {
      return regret[at(a)][s] < regret[at(b)][s];
    });
    choice.serves.push_back(by);
    choice.worst = std::max(choice.worst, regret[at(by)][s]);
  }
  choice.chosen = std::move(chosen);
  return choice;
}

}  // namespace

TableChoice choose_tables(const Regrets& regret, int most, double within,
                          const std::atomic<bool>* stop) {
  std::vector<double> levels;
  for (const auto& row : regret)
    for (const double r : row)
      if (r < kCannotServe) levels.push_back(r);
  std::sort(levels.begin(), levels.end());
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
  TableChoice choice;
  if (levels.empty()) return choice;
  std::vector<int> best;
  if (within >= 1) best = cover(regret, within, most, stop);
  if (best.empty()) {
    std::size_t low = 0, high = levels.size() - 1;
    for (best = cover(regret, levels[high], most, stop); low < high;) {
      const std::size_t middle = (low + high) / 2;
      std::vector<int> some = cover(regret, levels[middle], most, stop);
      if (some.empty()) {
        low = middle + 1;
      } else {
        high = middle;
        best = std::move(some);
      }
    }
  }
  return best.empty() ? choice : serve(regret, std::move(best));
}

TableChoice fewer_instances(const Regrets& regret, const std::vector<std::vector<int>>& xpu,
                            const TableChoice& choice, double within) {
  if (choice.chosen.empty()) return choice;
  const auto price = [&](const TableChoice& c) {
    std::size_t instances = 0;
    for (std::size_t i = 0; i < xpu.front().size(); ++i) {
      std::set<int> used;
      for (const int table : c.serves)
        if (xpu[at(table)][i] >= 0) used.insert(xpu[at(table)][i]);
      instances += used.size();
    }
    double sum = 0;
    for (std::size_t s = 0; s < c.serves.size(); ++s)
      sum += std::max(within, regret[at(c.serves[s])][s]);
    return std::max(within, c.worst) + sum / static_cast<double>(c.serves.size()) +
           kRegretOfAnInstance * static_cast<double>(instances);
  };
  TableChoice best = choice;
  double least = price(best);
  for (bool better = true; better;) {
    better = false;
    const TableChoice from = best;
    for (std::size_t k = 0; k < from.chosen.size(); ++k)
      for (std::size_t c = 0; c < regret.size(); ++c) {
        std::vector<int> chosen = from.chosen;
        chosen[k] = static_cast<int>(c);
        TableChoice other = serve(regret, std::move(chosen));
        if (other.worst >= least || price(other) >= least - 1e-9) continue;
        least = price(other);
        best = std::move(other);
        better = true;
      }
  }
  std::sort(best.chosen.begin(), best.chosen.end());
  best.chosen.erase(std::unique(best.chosen.begin(), best.chosen.end()), best.chosen.end());
  return best;
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// See construct.h.
#include "solver/construct.h"

#include <algorithm>
#include <functional>
#include <numeric>

#include "base/index.h"
#include "solver/bounds.h"

namespace xauto::solver {
namespace {

/// What a schedule of `list` is built by: urgency per XNode, charge per (XNode, XPU).
struct Rule {
  const std::vector<double>* rank;
  double weight;
  bool timed;  ///< take only what is released by the time the next XPU is free
};

class Lister {
 public:
  Lister(const Problem& problem, const std::vector<std::int64_t>& prices) : p_(problem) {
    const std::size_t n = at(p_.num_xnodes), m = at(p_.num_xpus);
    double rate = 0;
    for (std::size_t t = 0; t < prices.size(); ++t)
      rate += static_cast<double>(prices[t]) * static_cast<double>(p_.type_xpus[t].size());
    const double unit = rate > 0 ? static_cast<double>(p_.num_xpus) / rate : 0;
    excess_.assign(n * m, 0);
    for (std::size_t i = 0; i < n; ++i) {
      double cheapest = -1;
      for (std::size_t x = 0; x < m; ++x) {
        const Time wcet = p_.wcet_on(static_cast<int>(i), static_cast<int>(x));
        if (wcet == kCannotRun) continue;
        const double charge =
            unit * static_cast<double>(prices[at(p_.xpu_type[x])]) * static_cast<double>(wcet);
        excess_[i * m + x] = charge;
        if (cheapest < 0 || charge < cheapest) cheapest = charge;
      }
      for (std::size_t x = 0; x < m; ++x) excess_[i * m + x] -= cheapest;
    }
  }

  /// Charge above the cheapest XPU of `i`, in microseconds of a mean XPU.
  [[nodiscard]] double excess(int i, int x) const {
    return excess_[at(i) * at(p_.num_xpus) + at(x)];
  }

  Solution list(const Rule& rule) {
    const std::size_t n = at(p_.num_xnodes), m = at(p_.num_xpus);
    const std::vector<double>& rank = *rule.rank;
    std::vector<Time> free_at(m, 0), released(n, 0), start(n, 0);
    std::vector<int> missing(n);
    using Urgent = std::pair<double, int>;
    using Later = std::pair<Time, int>;
    std::vector<Urgent> open;
    std::vector<Later> later;
    Solution solution;
    solution.xpu.assign(n, -1);
    for (std::size_t i = 0; i < n; ++i) {
      missing[i] = static_cast<int>(p_.pred[i].size());
      if (missing[i] == 0) open.emplace_back(rank[i], static_cast<int>(i));
    }
    std::make_heap(open.begin(), open.end());
    const auto put = [&](int i) {
      open.emplace_back(rank[at(i)], i);
      std::push_heap(open.begin(), open.end());
    };
    while (!open.empty() || !later.empty()) {
      if (!later.empty()) {
        Time now = *std::min_element(free_at.begin(), free_at.end());
        if (open.empty()) now = std::max(now, later.front().first);
        while (!later.empty() && later.front().first <= now) {
          std::pop_heap(later.begin(), later.end(), std::greater<>());
          put(later.back().second);
          later.pop_back();
        }
      }
      std::pop_heap(open.begin(), open.end());
      const int i = open.back().second;
      open.pop_back();
      double best = 0;
      Time finish = 0;
      for (int x = 0; x < p_.num_xpus; ++x) {
        const Time wcet = p_.wcet_on(i, x);
        if (wcet == kCannotRun) continue;
        const Time begin = std::max(released[at(i)], free_at[at(x)]);
        const double score = static_cast<double>(begin + wcet) + rule.weight * excess(i, x);
        if (solution.xpu[at(i)] >= 0 && score >= best) continue;
        best = score;
        solution.xpu[at(i)] = x;
        start[at(i)] = begin;
        finish = begin + wcet;
      }
      free_at[at(solution.xpu[at(i)])] = finish;
      for (int s : p_.succ[at(i)]) {
        released[at(s)] = std::max(released[at(s)], finish);
        if (--missing[at(s)] != 0) continue;
        if (!rule.timed) {
          put(s);
          continue;
        }
        later.emplace_back(released[at(s)], s);
        std::push_heap(later.begin(), later.end(), std::greater<>());
      }
    }
    solution.sequence.resize(n);
    std::iota(solution.sequence.begin(), solution.sequence.end(), 0);
    std::stable_sort(solution.sequence.begin(), solution.sequence.end(), [&](int a, int b) {
      return start[at(a)] != start[at(b)] ? start[at(a)] < start[at(b)] : rank[at(a)] > rank[at(b)];
    });
    return solution;
  }

 private:
  const Problem& p_;
  std::vector<double> excess_;  // [xnode * num_xpus + xpu]
};

}  // namespace

std::vector<Solution> priced_solutions(const Problem& problem, const CompositeBound& composite,
                                       const Until& until) {
  const std::size_t n = at(problem.num_xnodes);
  Lister lister(problem, composite.prices);
  // Tails that know the load behind; longest paths of mean WCETs; of the WCETs of the cheapest XPU.
  const std::vector<Time> least = least_wcet(problem);
  std::vector<double> ranks[3];
  for (auto& rank : ranks) rank.assign(n, 0);
  for (std::size_t k = n; k-- > 0;) {
    const int i = problem.topo[k];
    double mean_tail = 0, cheap_tail = 0, sum = 0, count = 0, cheap = 0;
    for (int s : problem.succ[at(i)]) {
      mean_tail = std::max(mean_tail, ranks[1][at(s)]);
      cheap_tail = std::max(cheap_tail, ranks[2][at(s)]);
    }
    for (int x = 0; x < problem.num_xpus; ++x) {
      const Time wcet = problem.wcet_on(i, x);
      if (wcet == kCannotRun) continue;
      sum += static_cast<double>(wcet);
      count += 1;
      if (lister.excess(i, x) <= 0) cheap = static_cast<double>(wcet);
    }
    ranks[0][at(i)] = static_cast<double>(composite.tails[at(i)] + least[at(i)]);
    ranks[1][at(i)] = mean_tail + sum / count;
    ranks[2][at(i)] = cheap_tail + cheap;
  }
  std::vector<Solution> solutions;
  Evaluator evaluator(problem);
  const auto add = [&](const Rule& rule) {
    if (!solutions.empty() && until.over()) return;
    Solution solution = lister.list(rule);
    gather_groups(problem, solution.xpu);
    evaluator.reset(solution.xpu, solution.sequence);
    solution.makespan = evaluator.makespan();
    solutions.push_back(std::move(solution));
  };
  for (const double weight : {8.0, 16.0, 4.0})
    for (const int rank : {1, 0}) add({&ranks[rank], weight, true});
  // Short lists, good at once, which end higher.
  for (const double weight : {2.0, 1.0, 3.0, 0.5})
    for (const int rank : {1, 0, 2})
      for (const bool timed : {true, false}) add({&ranks[rank], weight, timed});
  return solutions;
}

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// See order.h.
#include "solver/order.h"

#include <algorithm>
#include <cstdint>
#include <numeric>

#include "base/index.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

/// Which XNodes come before which, edges and order pairs together; one bit row per XNode. Ended by
/// `until`, it knows less.
class Reach {
 public:
  Reach(std::size_t n, const std::vector<std::vector<int>>& succ, const std::vector<int>& topo,
        const Until& until)
      : words_((n + 63) / 64), bits_(n * words_, 0) {
    for (std::size_t k = topo.size(); k-- > 0;) {
      if (k % 64 == 0 && until.over()) return;
      const std::size_t i = at(topo[k]);
      for (int s : succ[i]) {
        bits_[i * words_ + at(s) / 64] |= std::uint64_t{1} << (at(s) % 64);
        for (std::size_t w = 0; w < words_; ++w) bits_[i * words_ + w] |= bits_[at(s) * words_ + w];
      }
    }
  }
  [[nodiscard]] bool before(int a, int b) const {
    return (bits_[at(a) * words_ + at(b) / 64] >> (at(b) % 64) & 1) != 0;
  }

 private:
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
};

std::vector<int> topological(const std::vector<std::vector<int>>& succ) {
  std::vector<int> missing(succ.size(), 0), order;
  for (const auto& list : succ)
    for (int s : list) ++missing[at(s)];
  for (std::size_t i = 0; i < succ.size(); ++i)
    if (missing[i] == 0) order.push_back(static_cast<int>(i));
  for (std::size_t k = 0; k < order.size(); ++k)
    for (int s : succ[at(order[k])])
      if (--missing[at(s)] == 0) order.push_back(s);
  return order;
}

}  // namespace

std::vector<std::pair<int, int>> order_pairs(const Problem& problem, const Solution& solution,
                                             const Until& until) {
  const std::size_t n = at(problem.num_xnodes);
  std::vector<std::pair<int, int>> pairs;
  std::vector<int> last(at(problem.num_xpus), -1);
  std::vector<std::vector<int>> succ = problem.succ;
  for (int i : solution.sequence) {
    int& before = last[at(solution.xpu[at(i)])];
    if (before >= 0) {
      pairs.emplace_back(before, i);
      succ[at(before)].push_back(i);
    }
    before = i;
  }
  const Reach reach(n, succ, topological(succ), until);
  // Redundant: an edge of the app says the same, or another successor of u comes before v.
  std::erase_if(pairs, [&](const std::pair<int, int>& pair) {
    const auto& [u, v] = pair;
    const auto& direct = problem.succ[at(u)];
    if (std::find(direct.begin(), direct.end(), v) != direct.end()) return true;
    return std::any_of(succ[at(u)].begin(), succ[at(u)].end(),
                       [&, w = v](int s) { return s != w && reach.before(s, w); });
  });
  return pairs;
}

std::vector<char> where_some_suspend(int num_xpus, const std::vector<int>& xpu,
                                     const std::vector<Time>& start,
                                     const std::vector<Time>& finish) {
  std::vector<std::size_t> all(xpu.size());
  std::iota(all.begin(), all.end(), 0U);
  std::ranges::sort(all, {}, [&](std::size_t i) { return start[i]; });
  std::vector<Time> end(at(num_xpus), 0);
  std::vector<char> found(at(num_xpus), 0);
  for (const std::size_t i : all) {
    const std::size_t x = at(xpu[i]);
    if (start[i] < end[x]) found[x] = 1;
    end[x] = std::max(end[x], finish[i]);
  }
  return found;
}

Decision order_undisturbed(const Problem& problem, const Decision& decision) {
  const Simulation simulation = simulate(problem, decision);
  const std::vector<char> disturbed =
      where_some_suspend(problem.num_xpus, decision.xpu, simulation.start, simulation.finish);
  std::vector<std::vector<int>> on_xpu(at(problem.num_xpus));
  for (int i = 0; i < problem.num_xnodes; ++i) on_xpu[at(decision.xpu[at(i)])].push_back(i);
  Decision ordered = decision;
  for (std::size_t x = 0; x < on_xpu.size(); ++x) {
    if (disturbed[x] != 0) continue;
    std::vector<int>& list = on_xpu[x];
    std::sort(list.begin(), list.end(),
              [&](int a, int b) { return simulation.start[at(a)] < simulation.start[at(b)]; });
    // What was asked of this XPU follows from the whole order.
    std::erase_if(ordered.order, [&](const std::pair<int, int>& pair) {
      return at(decision.xpu[at(pair.first)]) == x;
    });
    for (std::size_t k = 1; k < list.size(); ++k) {
      const auto& direct = problem.succ[at(list[k - 1])];
      if (std::find(direct.begin(), direct.end(), list[k]) == direct.end())
        ordered.order.emplace_back(list[k - 1], list[k]);
    }
  }
  return ordered;
}

}  // namespace xauto::solver

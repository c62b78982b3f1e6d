// SPDX-License-Identifier: Apache-2.0
// See certify.h.
#include "solver/certify.h"

#include <algorithm>
#include <cstdint>
#include <numeric>

#include "base/index.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

/// Which XNodes come before which, edges and order pairs together; one bit row per XNode. Ended by
/// `until`, it knows less: whoever asks takes two XNodes for open of which nobody says otherwise.
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

/// [xnode of `on_xpu`, in its order] at most so many of them have started and not ended when it has
/// started and they are less urgent; see B in certify.h.
std::vector<int> depths(const Decision& decision, const std::vector<int>& on_xpu,
                        const Reach& reach) {
  std::vector<std::size_t> rising(on_xpu.size());
  std::iota(rising.begin(), rising.end(), std::size_t{0});
  std::sort(rising.begin(), rising.end(), [&](std::size_t a, std::size_t b) {
    return decision.priority[at(on_xpu[a])] < decision.priority[at(on_xpu[b])];
  });
  std::vector<int> depth(on_xpu.size(), 1);
  for (std::size_t a = 0; a < rising.size(); ++a)
    for (std::size_t b = 0; b < a; ++b) {
      const int i = on_xpu[rising[a]], j = on_xpu[rising[b]];
      if (!reach.before(i, j) && !reach.before(j, i))
        depth[rising[a]] = std::max(depth[rising[a]], depth[rising[b]] + 1);
    }
  return depth;
}

/// Depth-first over all chains, from the sources; see the formula in certify.h.
class Chains {
 public:
  Chains(const Problem& problem, const Decision& decision, const Until& until)
      : n_(at(problem.num_xnodes)), until_(until), succ_(problem.succ) {
    for (const auto& [u, v] : decision.order) succ_[at(u)].push_back(v);
    const std::vector<int> topo = topological(succ_);
    const Reach reach(n_, succ_, topo, until);
    own_.assign(n_, 0);
    interferers_.resize(n_);
    weight_.assign(n_, 0);
    source_.assign(n_, 1);
    for (const auto& list : succ_)
      for (int s : list) source_[at(s)] = 0;
    std::vector<std::vector<int>> on_xpu(at(problem.num_xpus));
    for (std::size_t i = 0; i < n_; ++i) on_xpu[at(decision.xpu[i])].push_back(static_cast<int>(i));
    std::vector<char> may_keep(n_, 0);  // the last level of its XPU
    for (std::size_t x = 0; x < on_xpu.size(); ++x) {
      if (problem.levels[x] == 0) continue;
      const std::vector<int> depth = depths(decision, on_xpu[x], reach);
      for (std::size_t k = 0; k < depth.size(); ++k)
        may_keep[at(on_xpu[x][k])] = depth[k] >= problem.levels[x];
    }
    for (int i = 0; i < problem.num_xnodes; ++i) {
      const std::size_t x = at(decision.xpu[at(i)]);
      Time blocking = 0;
      bool may_preempt = false;
      for (int j : on_xpu[x]) {
        if (j == i || reach.before(i, j) || reach.before(j, i)) continue;
        if (decision.priority[at(j)] > decision.priority[at(i)]) {
          interferers_[at(i)].push_back(j);
        } else if (problem.preemptive[x]) {
          may_preempt = true;
          if (may_keep[at(j)] != 0)
            blocking =
                std::max(blocking, problem.wcet_on(j, decision.xpu[at(j)]) + problem.preempt[x]);
        } else {
          blocking = std::max(blocking, problem.wcet_on(j, decision.xpu[at(j)]));
        }
      }
      weight_[at(i)] =
          problem.wcet_on(i, decision.xpu[at(i)]) + (may_preempt ? problem.preempt[x] : 0);
      own_[at(i)] = weight_[at(i)] + blocking;
    }
    // Per-XNode counting from each XNode to the end: the bound that prunes the enumeration.
    rest_.assign(n_, 0);
    for (std::size_t k = topo.size(); k-- > 0;) {
      const std::size_t i = at(topo[k]);
      Time after = 0;
      for (int s : succ_[i]) after = std::max(after, rest_[at(s)]);
      rest_[i] = after + own_[i];
      for (int j : interferers_[i]) rest_[i] += weight_[at(j)];
    }
    counted_.assign(n_, 0);
  }

  Time longest(std::int64_t max_steps) {
    steps_ = max_steps;
    std::vector<int> sources;
    for (std::size_t i = 0; i < n_; ++i)
      if (source_[i]) sources.push_back(static_cast<int>(i));
    visit(sources, 0);
    return best_;
  }

 private:
  void visit(std::vector<int> next, Time length) {
    if (next.empty()) {
      best_ = std::max(best_, length);
      return;
    }
    std::sort(next.begin(), next.end(), [&](int a, int b) { return rest_[at(a)] > rest_[at(b)]; });
    for (int i : next) {
      if (length + rest_[at(i)] <= best_) return;
      if (--steps_ < 0 || (steps_ % 256 == 0 && until_.over())) {
        steps_ = std::min<std::int64_t>(steps_, 0);
        best_ = std::max(best_, length + rest_[at(i)]);
        return;
      }
      // An XNode of the chain itself may also interfere with an earlier one of the chain only if
      // the two are unordered, which chain members never are.
      Time added = own_[at(i)];
      for (int j : interferers_[at(i)])
        if (counted_[at(j)]++ == 0) added += weight_[at(j)];
      visit(succ_[at(i)], length + added);
      for (int j : interferers_[at(i)]) --counted_[at(j)];
    }
  }

  std::size_t n_;
  const Until until_;
  std::vector<std::vector<int>> succ_, interferers_;
  std::vector<Time> own_, weight_, rest_;
  std::vector<char> source_;
  std::vector<int> counted_;
  Time best_ = 0;
  std::int64_t steps_ = 0;
};

/// The problem in which preemption is free and whoever may start by preempting takes that much
/// longer.
class Inflated {
 public:
  Inflated(const Problem& problem, const Decision& decision, const Until& until)
      : n_(at(problem.num_xnodes)), until_(until), given_(problem), problem_(problem) {
    std::vector<std::vector<int>> succ = problem.succ;
    for (const auto& [u, v] : decision.order) succ[at(u)].push_back(v);
    reach_.emplace(n_, succ, topological(succ), until);
    std::fill(problem_.preempt.begin(), problem_.preempt.end(), 0);
    std::fill(problem_.preemptive.begin(), problem_.preemptive.end(), 1);
    std::fill(problem_.levels.begin(), problem_.levels.end(), 0);
    on_xpu_.resize(at(problem.num_xpus));
    for (int i = 0; i < problem.num_xnodes; ++i) on_xpu_[at(decision.xpu[at(i)])].push_back(i);
    for (std::size_t x = 0; x < on_xpu_.size(); ++x)
      for (const int i : on_xpu_[x])
        if (problem.preemptive[x] &&
            (until.over() || std::any_of(on_xpu_[x].begin(), on_xpu_[x].end(), [&](int j) {
               return open(i, j) && decision.priority[at(j)] < decision.priority[at(i)];
             })))
          problem_.wcet_flat[at(i) * at(problem.num_types) + at(problem.xpu_type[x])] +=
              problem.preempt[x];
  }

  [[nodiscard]] std::vector<Time> finishes(const Decision& decision) const {
    return simulate(problem_, decision).finish;
  }

  [[nodiscard]] bool follows(const Decision& decision, const std::vector<Time>& finish) const {
    for (std::size_t x = 0; x < on_xpu_.size(); ++x) {
      if (given_.levels[x] > 0) {
        if (until_.over()) return false;
        const std::vector<int> depth = depths(decision, on_xpu_[x], *reach_);
        if (std::any_of(depth.begin(), depth.end(), [&](int d) { return d > given_.levels[x]; }))
          return false;
      }
      // All of the XPU in the order of its priorities, whoever is open: then no pair is needed.
      std::vector<int> urgent = on_xpu_[x];
      std::sort(urgent.begin(), urgent.end(),
                [&](int a, int b) { return decision.priority[at(a)] > decision.priority[at(b)]; });
      if (given_.preemptive[x] && std::is_sorted(urgent.begin(), urgent.end(), [&](int a, int b) {
            return finish[at(a)] < finish[at(b)];
          }))
        continue;
      for (const int i : on_xpu_[x]) {
        if (until_.over()) return false;
        for (const int j : on_xpu_[x]) {
          if (!open(i, j) || decision.priority[at(i)] < decision.priority[at(j)]) continue;
          if (!given_.preemptive[x] || finish[at(i)] > finish[at(j)]) return false;
        }
      }
    }
    return true;
  }

 private:
  /// Neither edges nor order pairs say which of the two is first.
  [[nodiscard]] bool open(int i, int j) const {
    return i != j && !reach_->before(i, j) && !reach_->before(j, i);
  }

  std::size_t n_;
  const Until until_;
  const Problem& given_;
  Problem problem_;
  std::optional<Reach> reach_;
  std::vector<std::vector<int>> on_xpu_;
};

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

std::optional<Time> deadline_certificate(const Problem& problem, const Decision& decision,
                                         const Until& until) {
  const Inflated inflated(problem, decision, until);
  const std::vector<Time> finish = inflated.finishes(decision);
  if (!inflated.follows(decision, finish)) return std::nullopt;
  return *std::max_element(finish.begin(), finish.end());
}

Decision settle_priorities(const Problem& problem, const Decision& decision, const Until& until) {
  constexpr int kRounds = 12;
  const Time latency = simulate(problem, decision).makespan;
  Decision settled = decision;
  std::optional<Decision> best;
  Time least = 0;
  for (int round = 0; round < kRounds && !until.over(); ++round) {
    const Inflated inflated(problem, settled, until);
    const std::vector<Time> finish = inflated.finishes(settled);
    const bool follows = inflated.follows(settled, finish);
    const Time bound = *std::max_element(finish.begin(), finish.end());
    if (follows && simulate(problem, settled).makespan <= latency && (!best || bound < least)) {
      best = settled;
      least = bound;
    }
    Decision next = settled;
    next.priority = priorities_by_key(finish);
    if (next.priority == settled.priority) break;
    settled = std::move(next);
  }
  return best ? *best : decision;
}

Decision order_undisturbed(const Problem& problem, const Decision& decision) {
  const Simulation simulation = simulate(problem, decision);
  std::vector<std::vector<int>> on_xpu(at(problem.num_xpus));
  for (int i = 0; i < problem.num_xnodes; ++i) on_xpu[at(decision.xpu[at(i)])].push_back(i);
  Decision ordered = decision;
  for (std::size_t x = 0; x < on_xpu.size(); ++x) {
    std::vector<int>& list = on_xpu[x];
    std::sort(list.begin(), list.end(),
              [&](int a, int b) { return simulation.start[at(a)] < simulation.start[at(b)]; });
    bool disturbed = false;
    for (std::size_t k = 1; k < list.size(); ++k)
      disturbed = disturbed || simulation.start[at(list[k])] < simulation.finish[at(list[k - 1])];
    if (disturbed) continue;
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

Time worst_case(const Problem& problem, const Decision& decision, std::int64_t max_steps,
                const Until& until) {
  constexpr int kMostChained = 5000;  // XNodes: the lists of who delays whom are quadratic
  Time bound = 0;
  for (int i = 0; i < problem.num_xnodes; ++i) {
    const std::size_t x = at(decision.xpu[at(i)]);
    bound += problem.wcet_on(i, decision.xpu[at(i)]) +
             (problem.preemptive[x] != 0 ? problem.preempt[x] : 0);
  }
  if (problem.num_xnodes <= kMostChained)
    bound = std::min(bound, Chains(problem, decision, until).longest(max_steps));
  if (const auto by_deadlines = deadline_certificate(problem, decision, until))
    bound = std::min(bound, *by_deadlines);
  return bound;
}

}  // namespace xauto::solver

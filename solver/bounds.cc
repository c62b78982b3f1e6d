// SPDX-License-Identifier: Apache-2.0
// See bounds.h.
#include "solver/bounds.h"

#include <algorithm>
#include <set>

#include "base/index.h"
#include "solver/evaluate.h"

namespace xauto::solver {
namespace {}  // namespace

std::vector<Time> least_wcet(const Problem& problem) {
  std::vector<Time> least(at(problem.num_xnodes), kNever);
  for (int i = 0; i < problem.num_xnodes; ++i) {
    for (int t = 0; t < problem.num_types; ++t) {
      const Time wcet = problem.wcet(i, t);
      if (wcet != kCannotRun && !problem.type_xpus[at(t)].empty())
        least[at(i)] = std::min(least[at(i)], wcet);
    }
  }
  return least;
}

std::vector<Time> static_heads(const Problem& problem) {
  const std::vector<Time> least = least_wcet(problem);
  std::vector<Time> heads(least.size(), 0);
  for (int i : problem.topo)
    for (int p : problem.pred[at(i)])
      heads[at(i)] = std::max(heads[at(i)], heads[at(p)] + least[at(p)]);
  return heads;
}

std::vector<Time> static_tails(const Problem& problem) {
  const std::vector<Time> least = least_wcet(problem);
  std::vector<Time> tails(least.size(), 0);
  for (std::size_t k = problem.topo.size(); k-- > 0;) {
    const int i = problem.topo[k];
    for (int s : problem.succ[at(i)])
      tails[at(i)] = std::max(tails[at(i)], tails[at(s)] + least[at(s)]);
  }
  return tails;
}

Time critical_path_bound(const Problem& problem) {
  const std::vector<Time> least = least_wcet(problem), heads = static_heads(problem);
  Time bound = 0;
  for (std::size_t i = 0; i < least.size(); ++i) bound = std::max(bound, heads[i] + least[i]);
  return bound;
}

Time load_bound(const Problem& problem, const Until& until) {
  const std::vector<Time> least = least_wcet(problem), heads = static_heads(problem),
                          tails = static_tails(problem);
  // Types beyond the first 12 are left out of the subsets (the bound stays valid, only weaker).
  const int types = std::min(problem.num_types, 12);
  std::vector<unsigned> usable(least.size(), 0);
  for (int i = 0; i < problem.num_xnodes; ++i)
    for (int t = 0; t < problem.num_types; ++t)
      if (problem.wcet(i, t) != kCannotRun && !problem.type_xpus[at(t)].empty())
        usable[at(i)] |= 1u << std::min(t, 31);
  Time bound = 0;
  for (unsigned set = 1; set < (1u << types) && !until.over(); ++set) {
    Time work = 0, head = kNever, tail = kNever;
    std::int64_t instances = 0;
    for (int t = 0; t < types; ++t)
      if (set >> t & 1u) instances += static_cast<std::int64_t>(problem.type_xpus[at(t)].size());
    if (instances == 0) continue;
    for (std::size_t i = 0; i < least.size(); ++i) {
      if ((usable[i] & ~set) != 0) continue;
      work += least[i];
      head = std::min(head, heads[i]);
      tail = std::min(tail, tails[i]);
    }
    if (work > 0) bound = std::max(bound, head + (work + instances - 1) / instances + tail);
  }
  return bound;
}

Time placement_bound(const Problem& problem, const Until& until) {
  if (problem.forbidden.empty() && problem.groups.empty()) return 0;
  const std::vector<Time> heads = static_heads(problem), tails = static_tails(problem);
  const int n = problem.num_xnodes, m = problem.num_xpus;
  // Head, work and tail of XNodes that share something.
  struct Shared {
    Time head = kNever, work = 0, tail = kNever;
  };
  const auto join = [&](Shared& shared, int i) {
    shared.head = std::min(shared.head, heads[at(i)]);
    shared.tail = std::min(shared.tail, tails[at(i)]);
  };
  Time bound = 0;
  for (const auto& group : problem.groups) {
    Shared block;
    for (const int i : group) join(block, i);
    Time least = kNever;
    for (int x = 0; x < m; ++x) {
      Time sum = 0;
      for (const int i : group) {
        const Time wcet = problem.wcet_on(i, x);
        sum = wcet == kCannotRun || sum == kNever ? kNever : sum + wcet;
      }
      least = std::min(least, sum);
    }
    if (least < kNever) bound = std::max(bound, block.head + least + block.tail);
  }
  // Each set of XPUs that is all that some XNode has.
  std::set<std::vector<char>> sets;
  std::vector<std::vector<char>> open(at(n), std::vector<char>(at(m), 0));
  std::vector<Time> least(at(n), kNever);
  for (int i = 0; i < n; ++i) {
    for (int x = 0; x < m; ++x) {
      const Time wcet = problem.wcet_on(i, x);
      if (wcet == kCannotRun) continue;
      open[at(i)][at(x)] = 1;
      least[at(i)] = std::min(least[at(i)], wcet);
    }
    sets.insert(open[at(i)]);
  }
  for (const std::vector<char>& set : sets) {
    if (until.over()) break;
    const Time count = std::count(set.begin(), set.end(), char{1});
    if (count == 0) continue;
    Shared inside;
    for (int i = 0; i < n; ++i) {
      if (!std::equal(set.begin(), set.end(), open[at(i)].begin(),
                      [](char in, char needed) { return in != 0 || needed == 0; }))
        continue;
      join(inside, i);
      inside.work += least[at(i)];
    }
    bound = std::max(bound, inside.head + (inside.work + count - 1) / count + inside.tail);
  }
  return bound;
}

Time balanced_load_bound(const Problem& problem, std::vector<std::int64_t>* prices,
                         const Until& until) {
  const std::vector<Time> heads = static_heads(problem), tails = static_tails(problem);
  const std::size_t types = at(problem.num_types);
  const std::size_t steps = problem.num_xnodes > 200 ? 3 : 6;
  const auto quantiles = [&](std::vector<Time> values) {
    std::sort(values.begin(), values.end());
    std::vector<Time> chosen;
    for (std::size_t k = 0; k < steps; ++k)
      chosen.push_back(values[k * (values.size() - 1) / (2 * steps)]);
    chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
    return chosen;
  };
  std::vector<int> inside;
  // Largest multiplier 2^20, times 2^40 us, times 2^14.3 XNodes: below 2^75, hence the wide
  // integer.
  const auto value = [&](const std::vector<std::int64_t>& y) {
    __int128 work = 0, rate = 0;
    for (std::size_t t = 0; t < types; ++t)
      rate += static_cast<__int128>(y[t]) * static_cast<std::int64_t>(problem.type_xpus[t].size());
    if (rate == 0) return Time{0};
    for (int i : inside) {
      __int128 least = -1;
      for (std::size_t t = 0; t < types; ++t) {
        const Time wcet = problem.wcet(i, static_cast<int>(t));
        if (wcet == kCannotRun || problem.type_xpus[t].empty()) continue;
        const __int128 charge = static_cast<__int128>(y[t]) * wcet;
        if (least < 0 || charge < least) least = charge;
      }
      work += std::max<__int128>(least, 0);
    }
    return static_cast<Time>((work + rate - 1) / rate);
  };
  Time bound = 0;
  for (const Time h : quantiles(heads)) {
    for (const Time q : quantiles(tails)) {
      inside.clear();
      for (int i = 0; i < problem.num_xnodes; ++i)
        if (heads[at(i)] >= h && tails[at(i)] >= q) inside.push_back(i);
      std::vector<std::int64_t> y(types, 1 << 12);
      Time best = value(y);
      for (std::int64_t step = 8; step <= 1024; step *= 2) {
        for (int round = 0; round < 12; ++round) {
          bool better = false;
          for (std::size_t t = 0; t < types; ++t) {
            if (until.over()) break;
            for (const bool up : {true, false}) {
              std::vector<std::int64_t> trial = y;
              const std::int64_t change = std::max<std::int64_t>(1, trial[t] * 4 / step);
              trial[t] = std::clamp<std::int64_t>(trial[t] + (up ? change : -change), 0, 1 << 20);
              const Time now = value(trial);
              if (now <= best) continue;
              best = now;
              y = std::move(trial);
              better = true;
            }
          }
          if (!better) break;
        }
      }
      if (prices != nullptr && prices->empty())
        *prices = y;  // the first pair holds the most XNodes
      bound = std::max(bound, h + q + best);
    }
  }
  return bound;
}

Time quick_bound(const Problem& problem, const Until& until) {
  return std::max({critical_path_bound(problem), load_bound(problem, until),
                   placement_bound(problem, until), balanced_load_bound(problem, nullptr, until)});
}

}  // namespace xauto::solver

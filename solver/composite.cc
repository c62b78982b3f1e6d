// SPDX-License-Identifier: Apache-2.0
// See composite.h.
#include "solver/composite.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <queue>

#include "base/index.h"
#include "solver/bounds.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

using Prices = std::vector<std::int64_t>;

class Composite {
 public:
  Composite(const Problem& problem, const Until& until)
      : p_(problem),
        until_(until),
        n_(at(problem.num_xnodes)),
        least_(least_wcet(problem)),
        heads_(static_heads(problem)),
        tails_(static_tails(problem)) {
    // Fractions of a microsecond, as far as sums stay far below 2^63.
    const Time total = std::accumulate(least_.begin(), least_.end(), Time{0});
    scale_ = total < (Time{1} << 42) ? 1024 : 1;
    (void)balanced_load_bound(problem, &base_, until);
    if (base_.empty()) base_.assign(at(problem.num_types), 1 << 12);
  }

  CompositeBound run(int effort) {
    if (effort > 0) {
      fill_family();
      deepen(p_.pred, p_.succ, p_.topo, heads_);
      const std::vector<int> reversed(p_.topo.rbegin(), p_.topo.rend());
      deepen(p_.succ, p_.pred, reversed, tails_);
    }
    CompositeBound answer;
    answer.prices = base_;
    answer.bound = refine(answer.prices);
    answer.heads = heads_;
    answer.tails = tails_;
    for (std::size_t i = 0; i < n_; ++i)
      answer.bound = std::max(answer.bound, heads_[i] + least_[i] + tails_[i]);
    return answer;
  }

 private:
  /// p_i under prices `y`, in 1/scale_ us, rounded down.
  void worths(const Prices& y, std::vector<Time>& p) const {
    p.assign(n_, 0);
    __int128 rate = 0;
    for (std::size_t t = 0; t < y.size(); ++t)
      rate += static_cast<__int128>(y[t]) * static_cast<std::int64_t>(p_.type_xpus[t].size());
    if (rate == 0) return;
    for (std::size_t i = 0; i < n_; ++i) {
      __int128 least = -1;
      for (std::size_t t = 0; t < y.size(); ++t) {
        const Time wcet = p_.wcet(static_cast<int>(i), static_cast<int>(t));
        if (wcet == kCannotRun || p_.type_xpus[t].empty()) continue;
        const __int128 value = static_cast<__int128>(y[t]) * wcet;
        if (least < 0 || value < least) least = value;
      }
      p[i] = static_cast<Time>(least * scale_ / rate);
    }
  }

  /// The prices of the whole app, and others around them: part of an app may lack another type.
  void fill_family() {
    const std::size_t types = base_.size();
    std::vector<std::size_t> present;
    for (std::size_t t = 0; t < types; ++t)
      if (!p_.type_xpus[t].empty()) present.push_back(t);
    std::vector<Prices> family = {base_};
    const auto scaled = [](std::int64_t price, double factor) {
      return std::clamp<std::int64_t>(
          std::llround(static_cast<double>(std::max<std::int64_t>(price, 64)) * factor), 0,
          1 << 20);
    };
    constexpr double kFactors[] = {0.3, 0.55, 0.75, 0.88, 1.0, 1.15, 1.35, 1.8, 3.5};
    if (present.size() == 2) {
      for (const double f : kFactors) {
        family.push_back(base_);
        family.back()[present[1]] = scaled(base_[present[1]], f);
      }
    } else if (present.size() == 3) {
      for (const double f : kFactors)
        for (const double g : kFactors) {
          family.push_back(base_);
          family.back()[present[1]] = scaled(base_[present[1]], f);
          family.back()[present[2]] = scaled(base_[present[2]], g);
        }
    } else if (present.size() > 3) {
      Random random(1);
      for (int k = 0; k < 100; ++k) {
        family.push_back(base_);
        for (const std::size_t t : present)
          family.back()[t] = scaled(base_[t], std::exp(2.4 * (random.unit() - 0.5)));
      }
    }
    // One type alone, and all but one.
    for (const std::size_t t : present) {
      family.push_back(base_);
      family.back()[t] = 0;
      family.emplace_back(types, 0);
      family.back()[t] = 1 << 12;
    }
    for (const Prices& y : family) {
      if (until_.over()) break;
      worth_.emplace_back();
      worths(y, worth_.back());
      shares_.push_back(shares(y));
    }
  }

  /// Of the rate, per instance, dearest first, in 2^-20, rounded down.
  [[nodiscard]] std::vector<std::int64_t> shares(const Prices& y) const {
    std::int64_t rate = 0;
    for (std::size_t t = 0; t < y.size(); ++t)
      rate += y[t] * static_cast<std::int64_t>(p_.type_xpus[t].size());
    std::vector<std::int64_t> g;
    for (std::size_t t = 0; t < y.size() && rate > 0; ++t)
      g.insert(g.end(), p_.type_xpus[t].size(), (y[t] << 20) / rate);
    std::sort(g.rbegin(), g.rend());
    return g;
  }

  /// sum of g_k times the k-th smallest head plus the same for tails. An instance that gets nothing
  /// of S is lost for all of T, which is at least the largest head: it counts as that one with the
  /// heads (the cheapest do), as nothing with the tails (the dearest do).
  [[nodiscard]] Time edges(const std::vector<std::int64_t>& g) const {
    __int128 sum = 0;
    const std::size_t used = least_heads_.size(), unused = g.size() - used;
    for (std::size_t k = 0; k < g.size(); ++k)
      sum += static_cast<__int128>(g[k]) * least_heads_[std::min(k, used - 1)];
    for (std::size_t k = 0; k < used; ++k)
      sum += static_cast<__int128>(g[k + unused]) * least_tails_[k];
    return static_cast<Time>((sum * scale_) >> 20);
  }

  /// The second bound for all S = {head >= h, tail >= q}, a few q; `members` by descending head.
  [[nodiscard]] Time parallel(const std::vector<int>& members, const std::vector<Time>& head,
                              const std::vector<Time>& tail, const std::vector<Time>& p,
                              const std::vector<std::int64_t>& g, std::size_t thresholds) {
    sorted_.clear();
    for (const int i : members) sorted_.push_back(tail[at(i)]);
    std::sort(sorted_.begin(), sorted_.end());
    Time most = 0, before = -1;
    if (g.empty()) return 0;
    for (std::size_t k = 0; k < thresholds; ++k) {
      const Time q = sorted_[k * k * (sorted_.size() - 1) / (thresholds * thresholds)];
      if (q == before) continue;
      before = q;
      Time sum = 0;
      least_heads_.clear();
      least_tails_.clear();
      for (const int i : members) {
        if (tail[at(i)] < q) continue;
        sum += p[at(i)];
        // Heads come in descending order: the last are the smallest.
        least_heads_.insert(least_heads_.begin(), head[at(i)]);
        if (least_heads_.size() > g.size()) least_heads_.pop_back();
        const auto place = std::upper_bound(least_tails_.begin(), least_tails_.end(), tail[at(i)]);
        if (place != least_tails_.end() || least_tails_.size() < g.size()) {
          least_tails_.insert(place, tail[at(i)]);
          if (least_tails_.size() > g.size()) least_tails_.pop_back();
        }
        most = std::max(most, sum + edges(g));
      }
    }
    return (most + scale_ - 1) / scale_;
  }

  /// Raises `head` of every XNode by what its ancestors (by `pred`) need; `order`: topological.
  void deepen(const std::vector<std::vector<int>>& pred, const std::vector<std::vector<int>>& succ,
              const std::vector<int>& order, std::vector<Time>& head) {
    std::vector<Time> behind(n_, -1);  // longest path from an ancestor's end to i's start
    std::vector<int> rank(n_, 0), inside;
    for (std::size_t k = 0; k < n_; ++k) rank[at(order[k])] = static_cast<int>(k);
    for (const int i : order) {
      Time& h = head[at(i)];
      for (const int u : pred[at(i)]) h = std::max(h, head[at(u)] + least_[at(u)]);
      if (pred[at(i)].empty()) continue;
      // One predecessor alone: all that it waits for is in its own head.
      if (pred[at(i)].size() == 1) continue;
      if (worth_.empty() || until_.over()) continue;
      inside.clear();
      std::fill(behind.begin(), behind.end(), -1);
      for (const int u : pred[at(i)])
        if (behind[at(u)] < 0) {
          behind[at(u)] = 0;
          inside.push_back(u);
        }
      for (std::size_t k = 0; k < inside.size(); ++k)
        for (const int u : pred[at(inside[k])])
          if (behind[at(u)] < 0) {
            behind[at(u)] = 0;
            inside.push_back(u);
          }
      std::sort(inside.begin(), inside.end(),
                [&](int a, int b) { return rank[at(a)] > rank[at(b)]; });
      for (const int u : inside) {
        Time longest = 0;
        for (const int s : succ[at(u)])
          if (s != i && behind[at(s)] >= 0)
            longest = std::max(longest, behind[at(s)] + least_[at(s)]);
        behind[at(u)] = longest;
      }
      // First without tails, one pass per price vector; then the bounds for the best few.
      std::sort(inside.begin(), inside.end(),
                [&](int a, int b) { return head[at(a)] > head[at(b)]; });
      ranking_.clear();
      for (std::size_t y = 0; y < worth_.size(); ++y) {
        Time sum = 0, most = 0;
        for (const int u : inside) {
          sum += worth_[y][at(u)];
          most = std::max(most, head[at(u)] * scale_ + sum);
        }
        ranking_.emplace_back(most, y);
      }
      const std::size_t tried = std::min<std::size_t>(4, ranking_.size());
      std::partial_sort(ranking_.begin(), ranking_.begin() + static_cast<std::ptrdiff_t>(tried),
                        ranking_.end(), std::greater<>());
      for (std::size_t k = 0; k < tried && !until_.over(); ++k) {
        const std::size_t y = ranking_[k].second;
        h = std::max(h, jackson(inside, head, behind, worth_[y]));
        h = std::max(h, parallel(inside, head, behind, worth_[y], shares_[y], 3));
      }
    }
  }

  /// Jackson's preemptive schedule of `members`, which are in descending order of head.
  Time jackson(const std::vector<int>& members, const std::vector<Time>& head,
               const std::vector<Time>& tail, const std::vector<Time>& p) const {
    std::priority_queue<std::pair<Time, int>> open;  // longest tail first
    left_.assign(p.begin(), p.end());
    Time now = 0, end = 0;
    std::size_t k = members.size();
    while (k > 0 || !open.empty()) {
      if (open.empty()) now = std::max(now, head[at(members[k - 1])] * scale_);
      while (k > 0 && head[at(members[k - 1])] * scale_ <= now) {
        --k;
        open.emplace(tail[at(members[k])], members[k]);
      }
      const int i = open.top().second;
      const Time next = k > 0 ? head[at(members[k - 1])] * scale_ : now + left_[at(i)];
      const Time run = std::min(left_[at(i)], std::max<Time>(0, next - now));
      now += run;
      left_[at(i)] -= run;
      if (left_[at(i)] > 0) continue;
      end = std::max(end, now + open.top().first * scale_);
      open.pop();
    }
    return (end + scale_ - 1) / scale_;
  }

  Time value(const Prices& y, const std::vector<int>& all) {
    worths(y, trial_);
    return std::max(jackson(all, heads_, tails_, trial_),
                    parallel(all, heads_, tails_, trial_, shares(y), 12));
  }

  /// Coordinate search over the prices, from those of the whole app.
  Time refine(Prices& y) {
    std::vector<int> all(n_);
    std::iota(all.begin(), all.end(), 0);
    std::stable_sort(all.begin(), all.end(),
                     [&](int a, int b) { return heads_[at(a)] > heads_[at(b)]; });
    Time best = value(y, all);
    for (double step : {0.4, 0.2, 0.1, 0.05, 0.02, 0.01}) {
      for (int round = 0; round < 6; ++round) {
        bool better = false;
        for (std::size_t t = 0; t < y.size(); ++t) {
          for (const double factor : {1 + step, 1 / (1 + step)}) {
            if (until_.over()) return best;
            Prices trial = y;
            trial[t] = std::clamp<std::int64_t>(
                std::llround(static_cast<double>(trial[t]) * factor), 0, 1 << 20);
            const Time now = value(trial, all);
            if (now <= best) continue;
            best = now;
            y = std::move(trial);
            better = true;
          }
        }
        if (!better) break;
      }
    }
    return best;
  }

  const Problem& p_;
  const Until until_;
  const std::size_t n_;
  std::vector<Time> least_, heads_, tails_;
  Time scale_ = 1;
  Prices base_;
  std::vector<std::vector<Time>> worth_;
  std::vector<std::vector<std::int64_t>> shares_;
  std::vector<std::pair<Time, std::size_t>> ranking_;
  std::vector<Time> trial_, sorted_, least_heads_, least_tails_;
  mutable std::vector<Time> left_;
};

}  // namespace

CompositeBound composite_bound(const Problem& problem, int effort, const Until& until) {
  return Composite(problem, until).run(effort);
}

}  // namespace xauto::solver

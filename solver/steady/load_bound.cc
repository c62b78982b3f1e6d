// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/load_bound.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <deque>
#include <limits>
#include <queue>
#include <utility>

namespace xauto::solver::steady {
namespace {

using Int = __int128;

/// Weights, and the values of objectives, are whole, in units of 2^-20.
constexpr int kShift = 20;
constexpr std::int64_t kOne = std::int64_t{1} << kShift;
constexpr int kPicks = 48, kAscent = 160;
/// Of one XPU, whose pairs are looked at.
constexpr std::ptrdiff_t kMostOnXpu = 64;
/// Steps of one round of an ascent, some ms: larger objectives are left without a bound.
constexpr std::size_t kMostStepsOfRound = 2'000'000;
/// Prices and visits up to here times work of 2^47 fit 127 bits, with room for their sums.
constexpr double kMostPrice = 0x1p66;
constexpr std::int64_t kMostVisits = std::int64_t{1} << 58;

/// What is bounded: the sum of weight * term, or the largest of them.
struct Objective {
  const std::vector<Term>& terms;
  std::vector<std::int64_t> weight;  ///< [term] in units of 2^-20; 0: it does not count
  bool largest = false;
};

/// One case: types that are left to each XNode, a bit per type.
struct Case {
  Int bound = 0;
  std::vector<std::uint32_t> left;
  std::vector<double> price;  ///< [type] to begin the ascent with
  int split = -1;             ///< XNode to be fixed next; -1: none is split
};

bool is_fixed(std::uint32_t left) {
  return std::has_single_bit(left);
}

/// Visits of one or more picks, and what they wait.
struct Visits {
  std::vector<std::int64_t> of;  ///< [xnode] times the weights
  Int waits = 0;
  std::int64_t picks = 0;

  explicit Visits(std::size_t n) : of(n, 0) {}
  struct Pick {
    std::vector<std::pair<int, std::int64_t>> visits;  ///< XNode and weight
    Int waits = 0;
  };
  void add(const Pick& pick, std::int64_t sign) {
    for (const auto& [xnode, weight] : pick.visits) of[at(xnode)] += sign * weight;
    waits += sign * pick.waits;
    picks += sign;
  }
  [[nodiscard]] double mean(std::size_t i) const {
    return static_cast<double>(of[i]) / static_cast<double>(std::max<std::int64_t>(1, picks));
  }
};

class Bounder {
 public:
  Bounder(const Problem& p, Objective objective)
      : p_(p), objective_(std::move(objective)), best_(at(p.num_xnodes)) {
    types_ = at(p.num_types);
    work_.assign(at(p.num_xnodes) * types_, kNoTick);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)])
        work_[at(i) * types_ + at(p.xpu_type[at(m)])] = p.wcet(i, m);
    for (const auto& xpus : p.type_xpus) count_.push_back(static_cast<double>(xpus.size()));
    for (const Term& term : objective_.terms)
      for (const LoadWay& way : term.ways)
        for (const Piece& piece : way.pieces) {
          std::vector<int> order;
          for (const int i : p.components[at(p.component_of[at(piece.to)])].xnodes)
            if (i == piece.to || p.before(i, piece.to)) order.push_back(i);
          order_.push_back(std::move(order));
        }
    until_.resize(at(p.num_xnodes));
    by_.resize(at(p.num_xnodes));
    type_.resize(at(p.num_xnodes));
  }

  [[nodiscard]] Case whole() const {
    Case c;
    c.price.assign(types_, 0);
    for (int i = 0; i < p_.num_xnodes; ++i) {
      std::uint32_t left = 0;
      for (std::size_t t = 0; t < types_; ++t)
        if (work_[at(i) * types_ + t] != kNoTick) left |= 1U << t;
      c.left.push_back(left);
    }
    return c;
  }

  /// Its bound, the prices and who is to be fixed next. Ended by `until` after some rounds it is
  /// weaker.
  void bound(Case& c, const Until& until) {
    const std::size_t n = at(p_.num_xnodes);
    std::vector<double> y = c.price, best_y = y, load(types_);
    Visits visits(n);
    std::deque<Visits::Pick> picks;
    std::vector<double> share(n * types_, 0);
    double scale = 0, best = 0;
    // Picks answer to the mean of the prices so far, prices to the mean of the picks.
    for (int round = 0; round < kAscent; ++round) {
      assign(c, visits, y, load);
      if (round >= kAscent / 2)
        for (std::size_t i = 0; i < n; ++i) share[i * types_ + at(type_[i])] += 1;
      double value = 0;
      picks.push_back(pick(value));
      scale = std::max(scale, value);
      visits.add(picks.back(), 1);
      if (picks.size() > kPicks) {  // the oldest know least
        visits.add(picks.front(), -1);
        picks.pop_front();
      }
      const double step = scale / (2 + 0.25 * round);
      for (std::size_t t = 0; t < types_; ++t)
        y[t] = std::max(0.0, y[t] + step * (load[t] - count_[t]));
      const double found = estimate(c, visits, y);
      if (round == 0 || found > best) {
        best = found;
        best_y = y;
        best_ = visits;
      }
      if (until.over()) break;
    }
    c.bound = std::max(c.bound, exact(c, best_y));
    c.price = best_y;
    c.split = -1;
    double most = 0.02 * static_cast<double>(kAscent);
    for (std::size_t i = 0; i < n; ++i) {
      double largest = 0, sum = 0;
      for (std::size_t t = 0; t < types_; ++t) {
        largest = std::max(largest, share[i * types_ + t]);
        sum += share[i * types_ + t];
      }
      // Who is much split, and weighs much.
      const double weight = (sum - largest) * (best_.of[i] > 0 ? 4 : 1);
      if (!is_fixed(c.left[i]) && weight > most) {
        most = weight;
        c.split = static_cast<int>(i);
      }
    }
    if (c.split < 0) c.split = unfixed_of_pairs(c);
  }

 private:
  /// The cheapest type of each, and the load that follows.
  void assign(const Case& c, const Visits& visits, const std::vector<double>& y,
              std::vector<double>& load) {
    std::fill(load.begin(), load.end(), 0.0);
    for (std::size_t i = 0; i < type_.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      const double mean = visits.mean(i);
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const double cost = (mean + y[t] / period) * static_cast<double>(work_[i * types_ + t]);
        if (least < 0 || cost < least) {
          least = cost;
          type_[i] = static_cast<int>(t);
        }
      }
      if (least < 0) continue;
      load[at(type_[i])] += static_cast<double>(work_[i * types_ + at(type_[i])]) / period;
    }
  }

  /// Longest paths by `type_`: of each term, or of the term that is largest.
  Visits::Pick pick(double& value) {
    Visits::Pick sum, largest, way, longest;
    std::size_t piece = 0;
    value = 0;
    for (std::size_t k = 0; k < objective_.terms.size(); ++k) {
      const Term& term = objective_.terms[k];
      double most = -1;
      for (const LoadWay& w : term.ways) {
        const double takes = follow(w, piece, objective_.weight[k], way);
        piece += w.pieces.size();
        if (takes > most) {
          most = takes;
          std::swap(longest, way);
        }
      }
      if (most < static_cast<double>(term.known)) {
        most = static_cast<double>(term.known);
        longest = {{}, Int{term.known} * objective_.weight[k]};
      }
      const double weighted = most * static_cast<double>(objective_.weight[k]);
      if (objective_.largest) {
        if (weighted <= value) continue;
        value = weighted;
        std::swap(largest, longest);
      } else {
        value += weighted;
        sum.visits.insert(sum.visits.end(), longest.visits.begin(), longest.visits.end());
        sum.waits += longest.waits;
      }
    }
    return objective_.largest ? largest : sum;
  }

  /// Its longest path in each piece, whose orders begin at `piece`. Less than 0: there is none.
  double follow(const LoadWay& way, std::size_t piece, std::int64_t weight, Visits::Pick& pick) {
    pick.visits.clear();
    pick.waits = Int{way.ready + way.waits} * weight;
    auto sum = static_cast<double>(way.ready + way.waits);
    for (const Piece& q : way.pieces) {
      const std::vector<int>& order = order_[piece++];
      for (const int i : order) until_[at(i)] = -1;
      for (const int i : q.from) until_[at(i)] = 0, by_[at(i)] = -1;
      for (const int i : order) {
        for (const Link& link : p_.pred[at(i)])
          if (p_.before(link.xnode, q.to) && until_[at(link.xnode)] > until_[at(i)]) {
            until_[at(i)] = until_[at(link.xnode)];
            by_[at(i)] = link.xnode;
          }
        if (until_[at(i)] >= 0)
          until_[at(i)] += static_cast<double>(work_[at(i) * types_ + at(type_[at(i)])]);
      }
      if (until_[at(q.to)] < 0) return -1;
      sum += until_[at(q.to)];
      for (int i = q.to; i >= 0; i = by_[at(i)]) pick.visits.emplace_back(i, weight);
    }
    return sum;
  }

  double estimate(const Case& c, const Visits& visits, const std::vector<double>& y) const {
    double sum = static_cast<double>(visits.waits) / static_cast<double>(visits.picks);
    for (std::size_t i = 0; i < type_.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      const double mean = visits.mean(i);
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const double cost = (mean + y[t] / period) * static_cast<double>(work_[i * types_ + t]);
        if (least < 0 || cost < least) least = cost;
      }
      sum += std::max(0.0, least);
    }
    for (std::size_t t = 0; t < types_; ++t) sum -= y[t] * count_[t];
    return sum + static_cast<double>(of_pairs(c, visits)) / static_cast<double>(visits.picks);
  }

  /// In integers, rounded down.
  [[nodiscard]] Int exact(const Case& c, const std::vector<double>& y) const {
    std::vector<Int> price;
    // A negative mean is rounded down, too.
    Int sum = best_.waits / best_.picks - (best_.waits < 0 ? 1 : 0);
    for (std::size_t t = 0; t < types_; ++t) {
      if (y[t] > kMostPrice) return 0;
      price.push_back(static_cast<Int>(y[t]));
      sum -= price[t] * static_cast<Int>(p_.type_xpus[t].size());
    }
    for (std::size_t i = 0; i < best_.of.size(); ++i) {
      Int least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const Int work = work_[i * types_ + t];
        const Int cost =
            work * best_.of[i] / best_.picks + work * price[t] / p_.period_of(static_cast<int>(i));
        if (least < 0 || cost < least) least = cost;
      }
      if (least > 0) sum += least;
    }
    sum += of_pairs(c, best_) / best_.picks;
    return std::max<Int>(0, sum);
  }

  struct Pair {
    Int gain;
    int u, v;
  };
  /// What two XNodes of different clocks on the one XPU of type `t` add to the picks' sum.
  [[nodiscard]] Pair pair(std::size_t t, int u, int v, const Visits& visits) const {
    if (p_.domains[at(p_.domain_of(u))].clock == p_.domains[at(p_.domain_of(v))].clock)
      return {0, u, v};
    const Int of_u = Int{visits.of[at(v)]} * work_[at(u) * types_ + t];
    const Int of_v = Int{visits.of[at(u)]} * work_[at(v) * types_ + t];
    return {std::min(of_u, of_v), u, v};
  }

  /// Who is visited, of those of which `is_on` says that they are on type `t`; of many the heaviest.
  template <class IsOn>
  [[nodiscard]] std::vector<int> heaviest(std::size_t t, const Visits& visits, IsOn is_on) const {
    std::vector<int> on;
    for (std::size_t i = 0; i < visits.of.size(); ++i)
      if (visits.of[i] > 0 && is_on(i)) on.push_back(static_cast<int>(i));
    if (on.size() > static_cast<std::size_t>(kMostOnXpu)) {
      std::nth_element(on.begin(), on.begin() + kMostOnXpu, on.end(), [&](int a, int b) {
        return work_[at(a) * types_ + t] > work_[at(b) * types_ + t];
      });
      on.resize(static_cast<std::size_t>(kMostOnXpu));
    }
    return on;
  }

  /// The sum of pairs without a common XNode, the largest first, of those that are fixed.
  [[nodiscard]] Int of_pairs(const Case& c, const Visits& visits) const {
    Int sum = 0;
    for (std::size_t t = 0; t < types_; ++t) {
      if (p_.type_xpus[t].size() != 1) continue;
      const std::vector<int> on =
          heaviest(t, visits, [&](std::size_t i) { return c.left[i] == 1U << t; });
      std::vector<Pair> pairs;
      for (std::size_t a = 0; a < on.size(); ++a)
        for (std::size_t b = a + 1; b < on.size(); ++b)
          if (const Pair both = pair(t, on[a], on[b], visits); both.gain > 0) pairs.push_back(both);
      std::stable_sort(pairs.begin(), pairs.end(),
                       [](const Pair& a, const Pair& b) { return a.gain > b.gain; });
      std::vector<char> used(c.left.size(), 0);
      for (const Pair& both : pairs) {
        if (used[at(both.u)] != 0 || used[at(both.v)] != 0) continue;
        used[at(both.u)] = used[at(both.v)] = 1;
        sum += both.gain;
      }
    }
    return sum;
  }

  /// An XNode that is not fixed, of the pair that adds most if it is where the ascent has it.
  [[nodiscard]] int unfixed_of_pairs(const Case& c) const {
    Pair most{0, -1, -1};
    for (std::size_t t = 0; t < types_; ++t) {
      if (p_.type_xpus[t].size() != 1) continue;
      const std::vector<int> on =
          heaviest(t, best_, [&](std::size_t i) { return at(type_[i]) == t; });
      for (const int u : on)
        for (const int v : on)
          if (!is_fixed(c.left[at(u)]))
            if (const Pair both = pair(t, u, v, best_); both.gain > most.gain) most = both;
    }
    return most.u;
  }

  const Problem& p_;
  Objective objective_;
  std::size_t types_ = 0;
  std::vector<Tick> work_;  ///< [xnode * types + type]
  std::vector<double> count_;
  std::vector<std::vector<int>> order_;  ///< [piece] its XNodes, in topological order
  std::vector<double> until_;
  std::vector<int> by_, type_;
  Visits best_;
};

/// In units of 2^-20.
Int bound_of_cases(const Problem& p, const Objective& objective, int most_cases,
                   const Until& until) {
  if (p.num_types > 31) return 0;
  Int visits = 0;
  std::size_t steps = at(p.num_xnodes) * at(p.num_types);
  for (std::size_t k = 0; k < objective.terms.size(); ++k)
    for (const LoadWay& way : objective.terms[k].ways)
      for (const Piece& piece : way.pieces) {
        visits += Int{objective.weight[k]} * kPicks;
        steps += p.components[at(p.component_of[at(piece.to)])].xnodes.size();
      }
  if (visits > kMostVisits || steps > kMostStepsOfRound) return 0;
  Bounder bounder(p, objective);
  const auto later = [](const Case& a, const Case& b) { return a.bound > b.bound; };
  std::priority_queue<Case, std::vector<Case>, decltype(later)> open(later);
  Case first = bounder.whole();
  bounder.bound(first, until);
  open.push(std::move(first));
  for (int cases = 0; cases < most_cases && !until.over() && open.top().split >= 0; ++cases) {
    Case c = open.top();
    open.pop();
    const int i = c.split;
    for (int t = 0; t < p.num_types; ++t) {
      if (((c.left[at(i)] >> t) & 1U) == 0) continue;
      Case next = c;
      next.left[at(i)] = 1U << t;
      bounder.bound(next, until);
      open.push(std::move(next));
    }
  }
  return open.top().bound;
}

double down(double value) {
  return value <= 0 ? 0 : std::nextafter(value, 0.0);
}

}  // namespace

Tick load_bound(const Problem& p, const std::vector<LoadWay>& ways, int most_cases,
                const Until& until) {
  const std::vector<Term> one = {{ways}};
  return static_cast<Tick>(std::min<Int>(
      bound_of_cases(p, {one, {kOne}, true}, most_cases, until) >> kShift, kMostTicks));
}

double sum_bound(const Problem& p, const std::vector<Term>& terms, int most_cases,
                 const Until& until) {
  Objective sum{terms, {}};
  for (const Term& term : terms) {
    if (term.by > kMostVisits >> kShift) return 0;
    sum.weight.push_back(term.by * kOne);
  }
  return down(static_cast<double>(bound_of_cases(p, sum, most_cases, until)) /
              static_cast<double>(kOne));
}

double largest_bound(const Problem& p, const std::vector<Term>& terms, int most_cases,
                     const Until& until) {
  std::int64_t longest = 1;
  for (const Term& term : terms) longest = std::max(longest, term.by);
  // A weight of longest / deadline, rounded down: no ratio is less than it says.
  Objective largest{terms, {}, true};
  for (const Term& term : terms)
    largest.weight.push_back(static_cast<std::int64_t>(std::min<Int>(
        (Int{longest} << kShift) / std::max<std::int64_t>(1, term.by), std::int64_t{1} << 44)));
  return down(down(static_cast<double>(bound_of_cases(p, largest, most_cases, until)) /
                   static_cast<double>(kOne)) /
              static_cast<double>(longest));
}

}  // namespace xauto::solver::steady

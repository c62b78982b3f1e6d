// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/load_bound.h"

#include <algorithm>
#include <cmath>
#include <queue>

namespace xauto::solver::steady {
namespace {

/// Prices are whole, in units of 2^-20 ticks of time per share of an XPU; paths count alike.
constexpr int kShift = 20;
constexpr int kPaths = 48, kAscent = 160;

/// One case: types that are left to each XNode, a bit per type.
struct Case {
  Tick bound = 0;
  std::vector<std::uint32_t> left;
  std::vector<double> price;  ///< [type] to begin the ascent with
  int split = -1;             ///< XNode to be fixed next; -1: none is split
};

class Bounder {
 public:
  Bounder(const Problem& p, const std::vector<Piece>& pieces) : p_(p), pieces_(pieces) {
    types_ = at(p.num_types);
    work_.assign(at(p.num_xnodes) * types_, kNoTick);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)])
        work_[at(i) * types_ + at(p.xpu_type[at(m)])] = p.wcet(i, m);
    for (const auto& xpus : p.type_xpus) count_.push_back(static_cast<double>(xpus.size()));
    for (const Piece& piece : pieces) {
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

  /// Its bound, the prices and who is split. True if the prices prove that it overloads a type.
  void bound(Case& c) {
    const std::size_t n = at(p_.num_xnodes);
    std::vector<double> y = c.price, best_y = y, visits(n, 0), load(types_);
    std::vector<std::vector<int>> ways;
    std::vector<double> share(n * types_, 0);
    double scale = 0;
    // Paths answer to the mean of the prices so far, prices to the mean of the paths.
    for (int round = 0; round < kAscent; ++round) {
      assign(c, visits, std::max(1.0, static_cast<double>(ways.size())), y, load);
      if (round >= kAscent / 2)
        for (std::size_t i = 0; i < n; ++i) share[i * types_ + at(type_[i])] += 1;
      std::vector<int> way;
      const double length = longest(way);
      scale = std::max(scale, length);
      for (const int i : way) visits[at(i)] += 1;
      ways.push_back(std::move(way));
      if (ways.size() > kPaths) {  // the oldest know least
        for (const int i : ways.front()) visits[at(i)] -= 1;
        ways.erase(ways.begin());
      }
      const double step = scale / (2 + 0.25 * round);
      for (std::size_t t = 0; t < types_; ++t)
        y[t] = std::max(0.0, y[t] + step * (load[t] - count_[t]));
      const double value = estimate(c, visits, static_cast<double>(ways.size()), y);
      if (round == 0 || value > best_) {
        best_ = value;
        best_y = y;
        best_visits_ = visits;
        best_ways_ = static_cast<int>(ways.size());
      }
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
      const double weight = (sum - largest) * (best_visits_[i] > 0 ? 4 : 1);
      if ((c.left[i] & (c.left[i] - 1)) != 0 && weight > most) {
        most = weight;
        c.split = static_cast<int>(i);
      }
    }
  }

 private:
  /// The cheapest type of each, and the load that follows.
  void assign(const Case& c, const std::vector<double>& visits, double ways,
              const std::vector<double>& y, std::vector<double>& load) {
    std::fill(load.begin(), load.end(), 0.0);
    for (std::size_t i = 0; i < visits.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const auto work = static_cast<double>(work_[i * types_ + t]);
        const double cost = (visits[i] / ways + y[t] / period) * work;
        if (least < 0 || cost < least) {
          least = cost;
          type_[i] = static_cast<int>(t);
        }
      }
      if (least < 0) continue;
      load[at(type_[i])] += static_cast<double>(work_[i * types_ + at(type_[i])]) / period;
    }
  }

  double longest(std::vector<int>& way) {
    double sum = 0;
    for (std::size_t q = 0; q < pieces_.size(); ++q) {
      const Piece& piece = pieces_[q];
      for (const int i : order_[q]) until_[at(i)] = -1;
      for (const int i : piece.from) until_[at(i)] = 0, by_[at(i)] = -1;
      for (const int i : order_[q]) {
        for (const Link& link : p_.pred[at(i)])
          if (p_.before(link.xnode, piece.to) && until_[at(link.xnode)] > until_[at(i)]) {
            until_[at(i)] = until_[at(link.xnode)];
            by_[at(i)] = link.xnode;
          }
        if (until_[at(i)] >= 0)
          until_[at(i)] += static_cast<double>(work_[at(i) * types_ + at(type_[at(i)])]);
      }
      sum += until_[at(piece.to)];
      for (int i = piece.to; i >= 0; i = by_[at(i)]) way.push_back(i);
    }
    return sum;
  }

  double estimate(const Case& c, const std::vector<double>& visits, double ways,
                  const std::vector<double>& y) const {
    double sum = 0;
    for (std::size_t i = 0; i < visits.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const double cost =
            (visits[i] / ways + y[t] / period) * static_cast<double>(work_[i * types_ + t]);
        if (least < 0 || cost < least) least = cost;
      }
      sum += std::max(0.0, least);
    }
    for (std::size_t t = 0; t < types_; ++t) sum -= y[t] * count_[t];
    return sum;
  }

  /// In integers, rounded down.
  [[nodiscard]] Tick exact(const Case& c, const std::vector<double>& y) const {
    __int128 sum = 0;
    std::vector<std::int64_t> price;
    for (std::size_t t = 0; t < types_; ++t) {
      if (y[t] > static_cast<double>(kMostTicks)) return 0;
      price.push_back(static_cast<std::int64_t>(y[t]));
      sum -= (static_cast<__int128>(price[t]) << kShift) *
             static_cast<std::int64_t>(p_.type_xpus[t].size());
    }
    for (std::size_t i = 0; i < best_visits_.size(); ++i) {
      const auto visits = static_cast<std::int64_t>(std::llround(best_visits_[i]));
      __int128 least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const __int128 work = work_[i * types_ + t];
        // 2^47 * 2^47 * 2^20 fit, as do their parts.
        const __int128 cost = (work << kShift) * visits / best_ways_ +
                              (work << kShift) * price[t] / p_.period_of(static_cast<int>(i));
        if (least < 0 || cost < least) least = cost;
      }
      if (least > 0) sum += least;
    }
    return sum <= 0 ? 0 : static_cast<Tick>(std::min<__int128>(sum >> kShift, kMostTicks));
  }

  const Problem& p_;
  const std::vector<Piece>& pieces_;
  std::size_t types_ = 0;
  std::vector<Tick> work_;  ///< [xnode * types + type]
  std::vector<double> count_;
  std::vector<std::vector<int>> order_;  ///< [piece] its XNodes, in topological order
  std::vector<double> until_;
  std::vector<int> by_, type_;
  double best_ = 0;
  std::vector<double> best_visits_;
  int best_ways_ = 1;
};

}  // namespace

Tick load_bound(const Problem& p, const std::vector<Piece>& pieces, int most_cases,
                const Until& until) {
  if (p.num_types > 31) return 0;
  Bounder bounder(p, pieces);
  const auto later = [](const Case& a, const Case& b) { return a.bound > b.bound; };
  std::priority_queue<Case, std::vector<Case>, decltype(later)> open(later);
  Case first = bounder.whole();
  bounder.bound(first);
  open.push(std::move(first));
  for (int cases = 0; cases < most_cases && !until.over() && open.top().split >= 0; ++cases) {
    Case c = open.top();
    open.pop();
    const int i = c.split;
    for (int t = 0; t < p.num_types; ++t) {
      if (((c.left[at(i)] >> t) & 1U) == 0) continue;
      Case next = c;
      next.left[at(i)] = 1U << t;
      bounder.bound(next);
      open.push(std::move(next));
    }
  }
  return open.top().bound;
}

}  // namespace xauto::solver::steady

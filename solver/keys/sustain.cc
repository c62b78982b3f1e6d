// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/sustain.h"

#include <algorithm>
#include <cmath>

#include "solver/keys/unpackable.h"

namespace xauto::solver::keys {
namespace {

constexpr std::size_t kMostCauses = 8;  ///< XNodes that a proof names

// Prices that prove an overload. They are searched for in floating point, and what they prove is
// counted in integers: a worse search proves less, nothing wrong. None of these is tuned: chosen.
/// Rounds of the ascent: with modules; without; without, for more XNodes than kManyXNodes.
constexpr int kCrowdRounds = 600, kPriceRounds = 200, kPriceRoundsOfMany = 60;
constexpr int kManyXNodes = 2000;
/// Prices of types are also exchanged in pairs: by the first step, each smaller by the factor, down
/// to the last. Of more types than kMostExchanged the pairs are too many.
constexpr double kFirstExchange = 0.1, kExchangeFactor = 0.6, kLastExchange = 1e-5;
constexpr std::size_t kMostExchanged = 8;
constexpr double kSlopeError = 1e-9;  ///< of slopes, which are divided by the largest
/// A type is named in the proof if its price is more than one part of so many.
constexpr std::int64_t kNamedFrom = 50;
/// Prices of types and modules are in these parts of kWeights.
constexpr std::int64_t kPriceParts = 16;
/// Parts that a share is counted in, so that rounding it down takes little: with kWeights, 10^6 and
/// ticks of 2^47 they fit 128 bits.
constexpr std::int64_t kCrowdParts = 1 << 16, kShareParts = 1 << 20;
/// Up to here a load is told with two decimals, in percent: 100.01 is no 100.
constexpr std::int64_t kToldExactly = 110;

/// [xnode * places + place] work there; kNoTick: it cannot be there.
std::vector<Tick> work_by_place(const Problem& p) {
  std::vector<Tick> work;
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const auto& xpus : p.place_xpus) work.push_back(p.wcet(i, xpus.front()));
  return work;
}

/// XPUs of each place.
std::vector<std::int64_t> instances(const Problem& p) {
  std::vector<std::int64_t> count;
  for (const auto& xpus : p.place_xpus) count.push_back(static_cast<std::int64_t>(xpus.size()));
  return count;
}

double load_of(const std::vector<double>& rate, const std::vector<double>& w,
               std::vector<double>* slope) {
  const std::size_t types = w.size();
  double load = 0;
  if (slope != nullptr) slope->assign(types, 0);
  for (std::size_t i = 0; i < rate.size() / types; ++i) {
    std::size_t best = types;
    double least = 0;
    for (std::size_t t = 0; t < types; ++t) {
      const double r = rate[i * types + t];
      if (r >= 0 && (best == types || w[t] * r < least)) {
        best = t;
        least = w[t] * r;
      }
    }
    if (best == types) continue;
    load += least;
    if (slope != nullptr) (*slope)[best] += rate[i * types + best];
  }
  return load;
}

std::string name_of(const Problem& p, const std::vector<std::int64_t>& weights) {
  std::string names;
  for (std::size_t t = 0; t < weights.size(); ++t)
    if (weights[t] * kNamedFrom > kWeights)
      names += (names.empty() ? "" : " and ") + p.place_name(t);
  return names;
}

std::vector<std::pair<std::string, std::int64_t>> named(const Problem& p,
                                                        const std::vector<std::int64_t>& weights) {
  std::vector<std::pair<std::string, std::int64_t>> all;
  for (std::size_t t = 0; t < weights.size(); ++t) all.emplace_back(p.place_name(t), weights[t]);
  return all;
}

/// Load, and spans of modules, together: an XNode that is slow where the load is low may be too long for
/// its module.
class Crowd {
 public:
  explicit Crowd(const Problem& p) : p_(p), types_(p.place_xpus.size()), count_(instances(p)) {
    work_.assign(at(p.num_xnodes) * types_, kNoTick);
    std::vector<Tick> least(at(p.num_xnodes), 0);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)]) {
        work_[at(i) * types_ + at(p.xpu_place[at(m)])] = p.wcet(i, m);
        least[at(i)] = least[at(i)] == 0 ? p.wcet(i, m) : std::min(least[at(i)], p.wcet(i, m));
      }
    way_.assign(at(p.num_xnodes), -1);
    for (const Module& module : p.modules) {
      const Tick period = p.components[at(module.component)].period;
      if (module.in_flight > kMostTicks / period) continue;
      for (const int i : longest_way(module, least)) way_[at(i)] = static_cast<int>(room_.size());
      room_.push_back(module.in_flight * period);
    }
  }

  /// Prices of types, then of modules, sum kWeights: the best that were found.
  [[nodiscard]] std::vector<std::int64_t> prices() const {
    const std::size_t n = types_ + room_.size();
    std::vector<double> w(n, 1.0 / static_cast<double>(n)), best = w, slope(n);
    double best_value = -1;
    for (int round = 0; round < kCrowdRounds; ++round) {
      const double value = ascent(w, slope);
      if (value > best_value) {
        best_value = value;
        best = w;
      }
      double largest = kSlopeError, sum = 0;
      for (const double x : slope) largest = std::max(largest, std::abs(x - value));
      const double step = 1.0 / std::sqrt(1.0 + round);
      for (std::size_t k = 0; k < n; ++k)
        sum += w[k] *= std::exp(step * (slope[k] - value) / largest);
      for (double& x : w) x /= sum;
    }
    std::vector<std::int64_t> whole;
    for (const double x : best) whole.push_back(std::llround(x * kWeights * kPriceParts));
    return whole;
  }

  /// [xnode] of the value of these prices.
  [[nodiscard]] std::vector<std::pair<int, double>> shares(
      const std::vector<std::int64_t>& w) const {
    double sum = 0;
    for (const std::int64_t x : w) sum += static_cast<double>(x);
    std::vector<double> part(w.size());
    for (std::size_t k = 0; k < w.size(); ++k) part[k] = static_cast<double>(w[k]) / sum;
    std::vector<std::pair<int, double>> of;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const int way = way_[at(i)];
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (work_[at(i) * types_ + t] == kNoTick) continue;
        const auto c = static_cast<double>(work_[at(i) * types_ + t]);
        const double cost =
            c * part[t] / static_cast<double>(p_.period_of(i)) / static_cast<double>(count_[t]) +
            (way < 0 ? 0 : c * part[types_ + at(way)] / static_cast<double>(room_[at(way)]));
        if (least < 0 || cost < least) least = cost;
      }
      of.emplace_back(i, least);
    }
    return of;
  }

  /// floor(value * 10^6) in integers; above 10^6 no assignment serves all.
  [[nodiscard]] std::int64_t ppm(const std::vector<std::int64_t>& w) const {
    __int128 total = 0;
    std::int64_t sum = 0;
    for (const std::int64_t x : w) sum += x;
    if (sum <= 0) return 0;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      __int128 least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        const __int128 c = work_[at(i) * types_ + t];
        if (c == kNoTick) continue;
        __int128 share = c * w[t] * kMillion * kCrowdParts /
                         (static_cast<__int128>(p_.period_of(i)) * count_[t]);
        if (way_[at(i)] >= 0)
          share +=
              c * w[types_ + at(way_[at(i)])] * kMillion * kCrowdParts / room_[at(way_[at(i)])];
        if (least < 0 || share < least) least = share;
      }
      if (least > 0) total += least;
    }
    return static_cast<std::int64_t>(
        std::min<__int128>(total / sum / kCrowdParts, kMillion * 1'000'000));
  }

 private:
  /// From an entry to an XNode of the module, of the most least WCETs.
  [[nodiscard]] std::vector<int> longest_way(const Module& module,
                                             const std::vector<Tick>& least) const {
    std::vector<Tick> until(at(p_.num_xnodes), kNoTick);
    std::vector<int> by(at(p_.num_xnodes), -1), inside;
    for (const int i : p_.components[at(module.component)].xnodes)
      if (std::find(module.xnodes.begin(), module.xnodes.end(), i) != module.xnodes.end())
        inside.push_back(i);
    int last = -1;
    for (const int i : inside) {
      until[at(i)] = least[at(i)];
      for (const EdgeEnd& link : p_.pred[at(i)])
        if (until[at(link.xnode)] != kNoTick &&
            until[at(link.xnode)] + least[at(i)] > until[at(i)]) {
          until[at(i)] = until[at(link.xnode)] + least[at(i)];
          by[at(i)] = link.xnode;
        }
      if (last < 0 || until[at(i)] > until[at(last)]) last = i;
    }
    std::vector<int> way;
    for (int i = last; i >= 0; i = by[at(i)]) way.push_back(i);
    return way;
  }

  double ascent(const std::vector<double>& w, std::vector<double>& slope) const {
    std::fill(slope.begin(), slope.end(), 0.0);
    double value = 0;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const int way = way_[at(i)];
      double least = -1, on_type = 0, on_way = 0;
      std::size_t best = 0;
      for (std::size_t t = 0; t < types_; ++t) {
        if (work_[at(i) * types_ + t] == kNoTick) continue;
        const auto c = static_cast<double>(work_[at(i) * types_ + t]);
        const double load =
            c / static_cast<double>(p_.period_of(i)) / static_cast<double>(count_[t]);
        const double part = way < 0 ? 0 : c / static_cast<double>(room_[at(way)]);
        const double cost = w[t] * load + (way < 0 ? 0 : w[types_ + at(way)] * part);
        if (least >= 0 && cost >= least) continue;
        least = cost;
        best = t;
        on_type = load;
        on_way = part;
      }
      if (least < 0) continue;
      value += least;
      slope[best] += on_type;
      if (way >= 0) slope[types_ + at(way)] += on_way;
    }
    return value;
  }

  const Problem& p_;
  std::size_t types_;
  std::vector<std::int64_t> count_;
  std::vector<Tick> work_;  ///< [xnode * types + type]
  std::vector<int> way_;    ///< [xnode] whose module's way it is on, -1: none
  std::vector<Tick> room_;  ///< [way] N T
};

std::string us(const Problem& p, Tick t) {
  return std::to_string(t / p.scale) + " us";
}

}  // namespace

void keep_causes(std::vector<std::pair<int, double>> shares, OverloadProof& proof) {
  std::stable_sort(shares.begin(), shares.end(),
                   [](const auto& a, const auto& b) { return a.second > b.second; });
  if (shares.size() > kMostCauses) shares.resize(kMostCauses);
  for (const auto& [i, share] : shares)
    if (share > 0) proof.causes.emplace_back(i, std::llround(share * 1000));
}

std::vector<std::vector<int>> units(const Problem& p) {
  std::vector<std::vector<int>> all = p.groups;
  for (int i = 0; i < p.num_xnodes; ++i)
    if (p.group_of[at(i)] < 0) all.push_back({i});
  return all;
}

Tick span(const Problem& p, const std::vector<Tick>& takes, const Module& module, int from) {
  std::vector<Tick> until(at(p.num_xnodes), kNoTick);
  until[at(from)] = takes[at(from)];
  Tick longest = takes[at(from)];
  for (const int i : p.components[at(module.component)].xnodes) {
    for (const EdgeEnd& link : p.pred[at(i)])
      if (until[at(link.xnode)] != kNoTick)
        until[at(i)] = std::max(until[at(i)], until[at(link.xnode)] + takes[at(i)]);
  }
  for (const int i : module.xnodes) longest = std::max(longest, until[at(i)]);
  return longest;
}

std::int64_t load_ppm(const Problem& p, const std::vector<std::int64_t>& weights) {
  const std::vector<Tick> work = work_by_place(p);
  const std::vector<std::int64_t> count = instances(p);
  __int128 total = 0;
  std::int64_t sum = 0;
  for (const std::int64_t w : weights) sum += w;
  if (sum <= 0) return 0;
  for (const std::vector<int>& unit : units(p)) {
    __int128 least = -1;
    for (std::size_t t = 0; t < weights.size(); ++t) {
      __int128 share = 0;
      for (const int i : unit) {
        const Tick c = work[at(i) * count.size() + t];
        if (c == kNoTick) share = -1;
        if (share < 0) break;
        // Rounded down twice: never more than it is. 2^47 * 2^16 * 10^6 * 2^20 fit 128 bits.
        share += static_cast<__int128>(c) * weights[t] * kMillion * kShareParts /
                 (static_cast<__int128>(p.period_of(i)) * count[t]);
      }
      if (share >= 0 && (least < 0 || share < least)) least = share;
    }
    if (least > 0) total += least;
  }
  const __int128 load = total / sum / kShareParts;
  return static_cast<std::int64_t>(std::min<__int128>(load, kMillion * 1'000'000'000));
}

std::vector<std::int64_t> balancing_weights(const Problem& p) {
  const std::size_t types = p.place_xpus.size();
  const std::vector<Tick> work = work_by_place(p);
  const std::vector<std::int64_t> count = instances(p);
  std::vector<double> rate;  // [unit * places + place]
  for (const std::vector<int>& unit : units(p))
    for (std::size_t t = 0; t < types; ++t) {
      double& load = rate.emplace_back(0);
      for (const int i : unit) {
        const Tick c = work[at(i) * types + t];
        if (c == kNoTick) load = -1;
        if (load < 0) break;
        load += static_cast<double>(c) / static_cast<double>(p.period_of(i)) /
                static_cast<double>(count[t]);
      }
    }
  // Multiplicative ascent: a type that is loaded more than the others gets dearer.
  std::vector<double> w(types, 1.0 / static_cast<double>(types)), best = w, slope, mean(types, 0);
  double best_load = load_of(rate, w, nullptr);
  const auto consider = [&](const std::vector<double>& candidate) {
    const double load = load_of(rate, candidate, nullptr);
    if (load > best_load) {
      best_load = load;
      best = candidate;
    }
  };
  for (std::size_t t = 0; t < types; ++t) {
    std::vector<double> one(types, 0);
    one[t] = 1;
    consider(one);
  }
  const int rounds = p.num_xnodes > kManyXNodes ? kPriceRoundsOfMany : kPriceRounds;
  for (int r = 0; r < rounds; ++r) {
    static_cast<void>(load_of(rate, w, &slope));
    double largest = kSlopeError, sum = 0;
    for (const double s : slope) largest = std::max(largest, s);
    const double step = 1.0 / std::sqrt(1.0 + r);
    for (std::size_t t = 0; t < types; ++t) sum += w[t] *= std::exp(step * slope[t] / largest);
    for (double& x : w) x /= sum;
    consider(w);
    for (std::size_t t = 0; t < types; ++t) mean[t] += w[t] / rounds;
  }
  consider(mean);
  // Exchange between two types, finer and finer: exact for two, near enough for more.
  for (double step = kFirstExchange; step > kLastExchange; step *= kExchangeFactor)
    for (std::size_t a = 0; a < types; ++a)
      for (std::size_t b = 0; b < types; ++b) {
        if (a == b || types > kMostExchanged) continue;
        std::vector<double> next = best;
        const double moved = std::min(step, next[a]);
        next[a] -= moved;
        next[b] += moved;
        consider(next);
      }
  std::vector<std::int64_t> weights;
  for (const double x : best) weights.push_back(std::llround(x * kWeights));
  return weights;
}

namespace {

/// A group that no XPU has time for.
std::optional<OverloadProof> prove_group(const Problem& p) {
  for (const std::vector<int>& group : p.groups) {
    std::int64_t least = -1;  // ppm, rounded down
    std::vector<std::pair<int, double>> shares;
    for (const auto& xpus : p.place_xpus) {
      std::int64_t load = 0;
      std::vector<std::pair<int, double>> here;
      for (const int i : group) {
        const Tick c = p.wcet(i, xpus.front());
        if (c == kNoTick) load = -1;
        if (load < 0) break;
        const auto part = static_cast<std::int64_t>(std::min<__int128>(
            static_cast<__int128>(c) * kMillion / p.period_of(i), kMillion * kMillion));
        load += part;
        here.emplace_back(i, static_cast<double>(part) / static_cast<double>(kMillion));
      }
      if (load < 0 || (least >= 0 && load >= least)) continue;
      least = load;
      shares = std::move(here);
    }
    if (least <= kMillion) continue;
    OverloadProof proof;
    proof.load_pct = least / (kMillion / 100);
    proof.text = "the group of XNode '" + p.xnode_name[at(group.front())] +
                 "' asks one XPU for at least " + std::to_string(*proof.load_pct) + " %";
    keep_causes(std::move(shares), proof);
    return proof;
  }
  return std::nullopt;
}

std::optional<OverloadProof> prove_crowd(const Problem& p) {
  const Crowd crowd(p);
  const std::vector<std::int64_t> prices = crowd.prices();
  const std::int64_t ppm = crowd.ppm(prices);
  if (ppm <= kMillion) return std::nullopt;
  const std::size_t places = p.place_xpus.size();
  const std::vector<std::int64_t> on_places(prices.begin(),
                                            prices.begin() + static_cast<std::ptrdiff_t>(places));
  OverloadProof proof;
  proof.load_pct = ppm / (kMillion / 100);
  proof.text = name_of(p, on_places) +
               " and modules that have to end within their activations in " +
               "flight, together at least " + std::to_string(*proof.load_pct) + " %";
  proof.weights = named(p, on_places);
  std::size_t way = 0;
  for (const Module& module : p.modules) {
    if (module.in_flight > kMostTicks / p.components[at(module.component)].period) continue;
    if (const std::int64_t price = prices[places + way++]; price > 0)
      proof.module_weights.emplace_back(module.xnodes.front(), price);
  }
  keep_causes(crowd.shares(prices), proof);
  return proof;
}

}  // namespace

std::optional<OverloadProof> prove_overload(const Problem& p) {
  std::vector<Tick> least(at(p.num_xnodes), kNoTick);
  for (int i = 0; i < p.num_xnodes; ++i) {
    for (int m = 0; m < p.num_xpus; ++m)
      if (p.wcet(i, m) != kNoTick && (least[at(i)] == kNoTick || p.wcet(i, m) < least[at(i)]))
        least[at(i)] = p.wcet(i, m);
    if (!p.may_run[at(i)].empty()) continue;
    OverloadProof proof;
    proof.text = "XNode '" + p.xnode_name[at(i)] + "' takes at least " + us(p, least[at(i)]) +
                 " every " + us(p, p.period_of(i));
    proof.load_pct =
        static_cast<std::int64_t>(static_cast<__int128>(least[at(i)]) * 100 / p.period_of(i));
    proof.causes = {{i, 1000}};
    return proof;
  }
  for (const Module& module : p.modules) {
    const Tick period = p.components[at(module.component)].period;
    if (module.in_flight > kMostTicks / period) continue;
    for (const int e : module.entries) {
      const Tick takes = span(p, least, module, e);
      if (takes <= module.in_flight * period) continue;
      OverloadProof proof;
      proof.text = "an activation is in the module of XNode '" + p.xnode_name[at(e)] +
                   "' for at least " + us(p, takes) + ", " + std::to_string(module.in_flight) +
                   " in flight allow " + us(p, module.in_flight * period);
      proof.load_pct = static_cast<std::int64_t>(static_cast<__int128>(takes) * 100 /
                                                 (module.in_flight * period));
      std::vector<std::pair<int, double>> shares;
      for (const int i : module.xnodes)
        shares.emplace_back(
            i, static_cast<double>(least[at(i)]) / static_cast<double>(module.in_flight * period));
      keep_causes(std::move(shares), proof);
      return proof;
    }
  }
  if (std::optional<OverloadProof> group = prove_group(p)) return group;
  const std::vector<std::int64_t> weights = balancing_weights(p);
  const std::int64_t load = load_ppm(p, weights);
  if (load <= kMillion) {
    std::optional<OverloadProof> crowd = prove_crowd(p);
    return crowd ? crowd : prove_unpackable(p, kFirstLooks);
  }
  OverloadProof proof;
  proof.weights = named(p, weights);
  proof.load_pct = load / (kMillion / 100);
  // Rounded down, as "at least" says.
  std::string figure = std::to_string(*proof.load_pct);
  if (*proof.load_pct < kToldExactly) {
    const std::string rest = std::to_string(load / 100 % 100);
    figure += "." + std::string(2 - rest.size(), '0') + rest;
  }
  proof.text = name_of(p, weights) + " at least " + figure + " %";
  // Who weighs how much in it.
  const std::vector<Tick> work = work_by_place(p);
  const std::vector<std::int64_t> count = instances(p);
  std::int64_t sum = 0;
  for (const std::int64_t w : weights) sum += w;
  std::vector<std::pair<int, double>> shares;
  for (int i = 0; i < p.num_xnodes; ++i) {
    double cheapest = -1;
    for (std::size_t t = 0; t < weights.size(); ++t) {
      const Tick c = work[at(i) * weights.size() + t];
      if (c == kNoTick) continue;
      const double share = static_cast<double>(c) * static_cast<double>(weights[t]) /
                           (static_cast<double>(p.period_of(i)) * static_cast<double>(count[t]) *
                            static_cast<double>(sum));
      if (cheapest < 0 || share < cheapest) cheapest = share;
    }
    shares.emplace_back(i, cheapest);
  }
  keep_causes(std::move(shares), proof);
  return proof;
}

}  // namespace xauto::solver::keys

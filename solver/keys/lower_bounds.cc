// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/lower_bounds.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <set>

#include "solver/keys/joint_bound.h"
#include "solver/keys/load_bound.h"
#include "solver/keys/one_release.h"
#include "solver/keys/unpackable.h"

namespace xauto::solver::keys {
namespace {

/// Least WCETs along edges from `from` to `to`, both included; kNoTick: no way.
Tick least_way(const Problem& p, const std::vector<Tick>& least, int from, int to) {
  if (from == to) return least[at(from)];
  if (!p.before(from, to)) return kNoTick;
  std::vector<Tick> until(at(p.num_xnodes), kNoTick);
  until[at(from)] = least[at(from)];
  for (const int i : p.components[at(p.component_of[at(to)])].xnodes)
    for (const EdgeEnd& link : p.pred[at(i)])
      if (until[at(link.xnode)] != kNoTick)
        until[at(i)] = std::max(until[at(i)], until[at(link.xnode)] + least[at(i)]);
  return until[at(to)];
}

/// The waits of a way, of which nobody has less: from the component of `first` on.
Tick waits(const Problem& p, const Path& path, int first) {
  const Component& source = p.components[at(p.component_of[at(first)])];
  const auto rounds = [](Tick slowest, Tick period) {
    return ((slowest + period - 1) / period - 1) * period;
  };
  Tick slowest = source.period;  // of the whole way
  Tick in_run = source.period;   // since it came into this domain
  Tick sum = 0;
  enum class Entered { kSource, kFree, kKnown } entered = Entered::kSource;
  Tick common = 0;  // what a wait may be less than a whole period
  int domain = source.domain;
  std::vector<int> seen = {domain};
  std::vector<int> clocks = {p.domains[at(domain)].clock};
  bool one_clock = true;
  const auto leave = [&] {
    if (entered == Entered::kSource) sum += rounds(in_run, source.period);
    if (entered == Entered::kFree) sum += std::max(Tick{0}, in_run - common);
  };
  for (const int s : path.samples) {
    const int v = p.samples[at(s)].second;
    const Component& c = p.components[at(p.component_of[at(v)])];
    slowest = std::max(slowest, c.period);
    if (c.domain == domain) {
      in_run = std::max(in_run, c.period);
      continue;
    }
    const Domain& d = p.domains[at(c.domain)];
    const bool new_clock = std::find(clocks.begin(), clocks.end(), d.clock) == clocks.end();
    leave();
    // Back where its phase is known: nothing is added until it leaves again.
    entered = Entered::kKnown;
    common = 0;
    in_run = c.period;
    if (new_clock) {
      entered = Entered::kFree;
      in_run = in_slow_time(c.period, d.ppm);
    } else if (one_clock && d.ppm == 0 &&
               std::find(seen.begin(), seen.end(), c.domain) == seen.end()) {
      // All distances but for the part of a period that is common to all of them.
      Tick before = 1;
      for (const int g : seen) {
        const Tick hyper = p.domains[at(g)].hyper, by = hyper / std::gcd(before, hyper);
        if (by > kMostTicks / before) return rounds(slowest, source.period);
        before *= by;
      }
      entered = Entered::kFree;
      common = std::gcd(before, d.hyper);
    }
    one_clock = one_clock && !new_clock;
    domain = c.domain;
    seen.push_back(domain);
    if (new_clock) clocks.push_back(d.clock);
  }
  leave();
  return std::max(sum, rounds(slowest, source.period));
}

/// Where a way of a chain begins and what follows, for load_bound.
LoadWay way_of(const Problem& p, const Chain& chain, const Path& path) {
  const auto leaves_by = [&](std::size_t s) {
    return s < path.samples.size() ? p.samples[at(path.samples[s])].first : chain.to;
  };
  const int first = leaves_by(0);
  const Component& c = p.components[at(p.component_of[at(first)])];
  LoadWay way;
  way.pieces.resize(1);
  way.pieces[0].to = first;
  way.ready = kMostTicks;
  for (const int i : c.xnodes)
    if (p.root[at(i)] != 0 && (i == first || p.before(i, first))) {
      way.pieces[0].from.push_back(i);
      way.ready = std::min(way.ready, p.root_ready[at(i)]);
    }
  for (std::size_t s = 0; s < path.samples.size(); ++s)
    way.pieces.push_back({{p.samples[at(path.samples[s])].second}, leaves_by(s + 1)});
  way.waits = waits(p, path, first) - (chain.offset - c.phase);
  return way;
}

std::vector<LoadWay> ways_of(const Problem& p, const Chain& chain) {
  std::vector<LoadWay> ways;
  for (const Path& path : chain.paths) ways.push_back(way_of(p, chain, path));
  return ways;
}

/// What the pieces of a way behind the first take.
Tick behind_first(const Problem& p, const std::vector<Tick>& least, const LoadWay& way) {
  Tick behind = 0;
  for (std::size_t q = 1; q < way.pieces.size(); ++q)
    behind += std::max(Tick{0}, least_way(p, least, way.pieces[q].from.front(), way.pieces[q].to));
  return behind;
}

/// For joint_bound: of each XNode the longest, over all ways.
std::vector<Tail> tails_of(const Problem& p, const std::vector<Tick>& least,
                           const std::vector<LoadWay>& ways) {
  std::vector<Tick> tail(at(p.num_xnodes), kNoTick), longest = tail;
  std::set<int> met;
  for (const LoadWay& way : ways) {
    const int to = way.pieces.front().to;
    const std::vector<int>& all = p.components[at(p.component_of[at(to)])].xnodes;
    met.insert(all.begin(), all.end());
    for (const int i : all) tail[at(i)] = kNoTick;
    tail[at(to)] = behind_first(p, least, way);
    for (auto i = all.rbegin(); i != all.rend(); ++i) {
      for (const EdgeEnd& link : p.succ[at(*i)])
        if (tail[at(link.xnode)] != kNoTick)
          tail[at(*i)] = std::max(tail[at(*i)], tail[at(link.xnode)] + least[at(link.xnode)]);
      longest[at(*i)] = std::max(longest[at(*i)], tail[at(*i)]);
    }
  }
  std::vector<Tail> tails;
  for (const int i : met)
    if (longest[at(i)] != kNoTick) tails.push_back({i, longest[at(i)]});
  return tails;
}

/// Theorem 12: from the nominal release to the end of an XNode, of a release whose way meets a long piece of
/// work on an XPU that does not preempt.
class Pieces {
 public:
  Pieces(const Problem& p, const std::vector<Tick>& least, const std::vector<Tick>& ends)
      : p_(p), least_(least), ends_(ends), longest_(at(p.num_xpus), 0) {
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)])
        if (p.preemptive[at(m)] == 0) longest_[at(m)] = std::max(longest_[at(m)], p.wcet(i, m));
  }

  [[nodiscard]] Tick bound(int to, const Until& until) const {
    Tick bound = ends_[at(to)];
    std::vector<Tick> rest(at(p_.num_xnodes), kNoTick);  // from the end of each to that of `to`
    rest[at(to)] = 0;
    const std::vector<int>& all = p_.components[at(p_.component_of[at(to)])].xnodes;
    for (auto i = all.rbegin(); i != all.rend() && !until.over(); ++i) {
      for (const EdgeEnd& link : p_.succ[at(*i)])
        if (rest[at(link.xnode)] != kNoTick)
          rest[at(*i)] = std::max(rest[at(*i)], rest[at(link.xnode)] + least_[at(link.xnode)]);
      if (rest[at(*i)] != kNoTick) bound = std::max(bound, through(*i, rest[at(*i)], bound, until));
    }
    return bound;
  }

 private:
  /// Looks of one question whether an XNode may have an XPU without the long ones.
  static constexpr std::int64_t kLooks = 20'000;

  /// Without anybody in the way, on this XPU.
  [[nodiscard]] Tick alone(int x, int m, Tick rest) const {
    return ends_[at(x)] - least_[at(x)] + p_.wcet(x, m) + rest;
  }
  [[nodiscard]] Tick behind(int x, int m, Tick rest, Tick piece) const {
    return alone(x, m, rest) + piece + p_.wcet(x, m) - p_.period_of(x);
  }

  /// Above `known`, or that.
  [[nodiscard]] Tick through(int x, Tick rest, Tick known, const Until& until) const {
    std::vector<Tick> values;
    for (const int m : p_.may_run[at(x)]) {
      const Tick most = longest_[at(m)] == 0 ? 0 : behind(x, m, rest, longest_[at(m)]);
      if (std::max(alone(x, m, rest), most) <= known) return known;
      values.push_back(alone(x, m, rest));
      for (int b = 0; p_.preemptive[at(m)] == 0 && b < p_.num_xnodes; ++b)
        if (b != x && p_.wcet(b, m) != kNoTick) values.push_back(behind(x, m, rest, p_.wcet(b, m)));
    }
    std::sort(values.begin(), values.end());
    values.erase(values.begin(), std::upper_bound(values.begin(), values.end(), known));
    values.erase(std::unique(values.begin(), values.end()), values.end());
    std::size_t proven = 0, open = values.size();  // of the values, those below
    while (proven < open && !until.over()) {
      const std::size_t middle = (proven + open) / 2;
      if (holds(x, rest, values[middle]))
        proven = middle + 1;
      else
        open = middle;
    }
    return proven == 0 ? known : values[proven - 1];
  }

  /// Whether on each XPU it takes that long, or cannot be there without a piece by which it does.
  [[nodiscard]] bool holds(int x, Tick rest, Tick value) const {
    return std::all_of(p_.may_run[at(x)].begin(), p_.may_run[at(x)].end(), [&](int m) {
      if (alone(x, m, rest) >= value) return true;
      if (p_.preemptive[at(m)] != 0) return false;
      std::vector<int> apart;
      for (int b = 0; b < p_.num_xnodes; ++b)
        if (b != x && p_.wcet(b, m) != kNoTick && behind(x, m, rest, p_.wcet(b, m)) >= value)
          apart.push_back(b);
      return !apart.empty() && cannot_place(p_, x, m, apart, kLooks);
    });
  }

  const Problem& p_;
  const std::vector<Tick>& least_;
  const std::vector<Tick>& ends_;
  std::vector<Tick> longest_;  ///< [xpu] that does not preempt, of all that may be there
};

/// Of a chain's part of the time, for the proof of its end, and at most so many seconds.
constexpr double kForProofs = 0.5, kMostForProofS = 5;
/// Of the time for all chains together, for what follows from their releases at once.
constexpr double kForJoint = 0.5;

}  // namespace

std::vector<Tick> lower_bounds(const Problem& p, const AppSpec& app, const Platform& platform,
                               const Objectives& wishes, int most_cases, const Until& until) {
  const std::vector<Tick> least = least_wcets(p);
  // Longest ways from the roots' latest arrivals.
  std::vector<Tick> ends(at(p.num_xnodes), 0);
  for (const Component& c : p.components)
    for (const int i : c.xnodes) {
      Tick ready = p.root[at(i)] != 0 ? p.root_ready[at(i)] : 0;
      for (const EdgeEnd& link : p.pred[at(i)]) ready = std::max(ready, ends[at(link.xnode)]);
      ends[at(i)] = ready + least[at(i)];
    }
  // The plan of one release's bound on the ancestors, from the nominal release on.
  std::map<int, Tick> single;
  std::vector<Tick> bounds;
  const auto bound_of = [&](int to) {
    const auto [it, fresh] = single.emplace(to, ends[at(to)]);
    if (!fresh || until.over()) return it->second;
    it->second = std::max(it->second, quick_release_bound(app, platform, p, to, wishes, until));
    if (most_cases == 0) return it->second;
    // The proof of the solver of one release, as far as it comes in its part of the time.
    SolveOptions asked;
    asked.objectives = wishes;
    asked.stop = until.stop;
    asked.time_limit_s = kMostForProofS;
    if (const Until mine =
            part_of(until, kForProofs / static_cast<double>(p.chains.size() - bounds.size()));
        mine.deadline != TimePoint::max())
      asked.time_limit_s = std::min(
          asked.time_limit_s,
          std::chrono::duration<double>(mine.deadline - std::chrono::steady_clock::now()).count());
    if (asked.time_limit_s > 0)
      it->second = std::max(it->second, one_release_bound(app, platform, p, to, std::move(asked)));
    return it->second;
  };
  const Pieces pieces(p, least, ends);
  std::map<int, Tick> piece;
  for (const Chain& chain : p.chains) {
    Tick bound = 0;
    const std::vector<LoadWay> ways = ways_of(p, chain);
    for (const LoadWay& way : ways) {
      const int first = way.pieces.front().to;
      const auto [late, fresh] = piece.emplace(first, 0);
      if (fresh) late->second = pieces.bound(first, until);
      const Tick behind = behind_first(p, least, way);
      bound = std::max({bound, bound_of(first) + behind + way.waits,
                        late->second + behind -
                            (chain.offset - p.components[at(p.component_of[at(first)])].phase)});
    }
    if (!until.over())
      bound =
          std::max(bound, load_bound(p, ways, most_cases,
                                     part_of(until, 1.0 / static_cast<double>(p.chains.size() -
                                                                              bounds.size() + 1))));
    bounds.push_back(bound);
  }
  return bounds;
}

double objective_bound(const Problem& p, const std::vector<Tick>& bounds, bool sum, int most_cases,
                       const Until& until) {
  std::vector<Term> terms;
  std::vector<Ending> endings;
  const std::vector<Tick> least = least_wcets(p);
  double known = 0;
  for (std::size_t c = 0; c < p.chains.size(); ++c) {
    const Chain& chain = p.chains[c];
    if (!sum && p.deadlines && chain.deadline == kNoTick) continue;
    const double part = static_cast<double>(bounds[c]) / static_cast<double>(chain.by);
    known = sum ? known + static_cast<double>(chain.weight) * part : std::max(known, part);
    terms.push_back({ways_of(p, chain), bounds[c], sum ? chain.weight : 1, chain.by});
    endings.push_back({tails_of(p, least, terms.back().ways), chain.offset});
  }
  known = std::max(known, joint_bound(p, terms, endings, sum, part_of(until, kForJoint)));
  return std::max(known, sum ? sum_bound(p, terms, most_cases, until)
                             : largest_bound(p, terms, most_cases, until));
}

}  // namespace xauto::solver::keys

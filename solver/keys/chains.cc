// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/chains.h"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>
#include <optional>

namespace xauto::solver::keys {
namespace {

/// Figures of an XNode by any activation.
struct View {
  const Problem& p;
  const std::vector<Tick>& values;
  [[nodiscard]] Tick operator()(int xnode, std::int64_t activation) const {
    return values[p.slot_of(xnode, activation)];
  }
};

/// The earliest start of an activation: an urgent one may be sooner, and each may be urgent.
struct Earliest {
  const Problem& p;
  const std::vector<Tick>& values;
  [[nodiscard]] Tick operator()(int xnode, std::int64_t activation) const {
    return std::max(Tick{0}, values[p.slot_of(xnode, activation)] - p.urgent_by(xnode));
  }
};

/// A real length that is not shorter than `length` of a clock, which may be below 0.
Tick longest(Tick length, std::int64_t ppm) {
  return length > 0 ? in_slow_time(length, ppm) : length + in_slow_time(-length, ppm) + length;
}

/// The first activation n of `v` with release + earliest start certainly at or after release(k of cu) + after.
/// `latest`: the latest earliest start of v.
std::int64_t first_reader(const Problem& p, const Component& cu, std::int64_t k, Tick after, int v,
                          const Earliest& e, Tick latest) {
  const Component& cv = p.components[at(p.component_of[at(v)])];
  const std::int64_t ppm = p.domains[at(cv.domain)].ppm;
  const Tick from = cu.phase + k * cu.period;
  const auto late_enough = [&](std::int64_t n) {
    return least_distance(cv.phase + n * cv.period - from, ppm) + e(v, n) >= after;
  };
  // From the earliest that could do upwards.
  std::int64_t n = floor_div(from + after - latest - cv.phase, cv.period);
  while (!late_enough(n)) ++n;
  return n;
}

/// A release is at most `real` + `grid` after the way's beginning: the grid is of its clock, and drifts.
struct Mark {
  Tick real = 0, grid = 0;
};

/// Several of one release, of which the least counts. One keeps the place on the clock since the way came there;
/// each reader adds one, since the one before it was too early: it drifts less, and knows no place.
class Marks {
 public:
  explicit Marks(Mark first) { marks_[0] = first; }
  /// By the place on the clock alone.
  [[nodiscard]] Tick first(std::int64_t ppm) const {
    return marks_[0].real + longest(marks_[0].grid, ppm);
  }
  [[nodiscard]] Tick least(std::int64_t ppm) const {
    Tick least = first(ppm);
    for (std::size_t m = 1; m < count_; ++m)
      least = std::min(least, marks_[m].real + longest(marks_[m].grid, ppm));
    return least;
  }
  void go_on(Tick grid) {
    for (std::size_t m = 0; m < count_; ++m) marks_[m].grid += grid;
  }
  /// What is not kept is only a longer time. `check` keeps more.
  void at_most(Tick real) {
    if (count_ < marks_.size()) marks_[count_++] = {real, 0};
  }

 private:
  std::array<Mark, 6> marks_;
  std::size_t count_ = 1;
};

/// The XNode by which a way leaves the component before its sample `next`, or the chain's last.
int leaves_by(const Problem& p, const Chain& chain, const std::vector<int>& samples,
              std::size_t next) {
  return next < samples.size() ? p.samples[at(samples[next])].first : chain.to;
}

/// Releases of a way, on one clock, that are followed one by one: `check` follows as many.
constexpr Tick kMostFollowed = 500'000;
/// Activations of a way that are gone through where it comes back to a phase; beyond, that phase is forgotten.
constexpr std::int64_t kMostReturns = 100'000;
/// Readers of a drifting clock, of which one or the next is the first that knows, that are gone through both;
/// beyond, the later one counts.
constexpr std::int64_t kMostBranches = 1'000;
/// No way takes as long.
constexpr Tick kForeverAfter = std::numeric_limits<Tick>::max();

/// Worst time of a way, from the release of its source on.
struct Way {
  const Problem& p;
  const Chain& chain;
  const std::vector<int>& samples;
  View d;
  Earliest e;
  Tick sooner = 0;           ///< keys of the first component, where its release is urgent
  std::vector<Tick> most_e;  ///< [sample of the way] of its reader
  Tick latest = 0;           ///< earliest start of all XNodes
  /// What is the same whenever its reader, of another domain, is reached.
  struct Crossing {
    Tick left = kNoTick;  ///< what is left behind it, at any phase; kNoTick: not known yet
    std::optional<bool> comes_back;  ///< comes_back(); none: not known yet
  };
  std::vector<Crossing> crossings;  ///< [sample of the way]
  std::int64_t returns = kMostReturns;
  std::int64_t branches = kMostBranches;

  /// Whether releases and keys, from those of the first component on the clock of `v` to those of `v`, which
  /// samples[next] enters, come round soon enough.
  [[nodiscard]] bool followed(std::size_t next, int v) const {
    const auto clock_of = [&](int i) { return p.domains[at(p.domain_of(i))].clock; };
    Tick hyper = p.domains[at(p.domain_of(v))].hyper, least = p.period_of(v);
    for (std::size_t s = next + 1; s-- > 0;) {
      const int u = p.samples[at(samples[s])].first;
      if (clock_of(u) != clock_of(v)) break;
      least = std::min(least, p.period_of(u));
      const Tick turn = p.domains[at(p.domain_of(u))].hyper, by = turn / std::gcd(hyper, turn);
      if (by > kMostTicks / hyper) return false;
      hyper *= by;
      if (hyper / least > kMostFollowed) return false;
    }
    return true;
  }

  /// A release that the way began a domain's part with. What comes later on the same clock keeps its
  /// phase to it.
  struct Origin {
    const Component* component;
    std::int64_t k;
    Tick after;           ///< real time from the way's beginning
    std::size_t samples;  ///< of the way, that had been passed
  };

  /// `samples[next..]` is left, from the release k of the component of `v` on, which comes by `marks`.
  [[nodiscard]] Tick from(std::size_t next, std::int64_t k, Marks marks,
                          std::vector<Origin>& origins) {
    for (;;) {
      const int u = leaves_by(p, chain, samples, next);
      const Component& cu = p.components[at(p.component_of[at(u)])];
      const std::int64_t ppm = p.domains[at(cu.domain)].ppm;
      // ... and its result is where it is read.
      const Tick due = d(u, k) - (next == 0 ? sooner : 0) +
                       (next < samples.size() ? p.sample_passes[at(samples[next])] : 0);
      const Tick ends = marks.least(ppm) + due;
      if (next == samples.size()) return ends;
      const int v = p.samples[at(samples[next])].second;
      const Component& cv = p.components[at(p.component_of[at(v)])];
      if (cv.domain != cu.domain) return across(next, v, ends, marks.first(ppm) + due, origins);
      const std::int64_t n = first_reader(p, cu, k, due, v, e, most_e[next]);
      const auto gap = [&](std::int64_t m) {
        return cv.phase + m * cv.period - cu.phase - k * cu.period;
      };
      // Where the clock is slow an earlier one may know it. Whichever is the first that does, the one before it
      // began before the end.
      const auto reached_by = [&](std::int64_t m) {
        Marks reached = marks;
        reached.go_on(gap(m));
        reached.at_most(ends + in_slow_time(cv.period, ppm) - e(v, m - 1));
        return reached;
      };
      const auto may_know = [&](std::int64_t m) { return longest(gap(m), ppm) + e(v, m) >= due; };
      Tick sooner_known = 0;
      bool all = ppm > 0;
      for (std::int64_t m = n - 1; all && may_know(m); --m) {
        all = branches-- > 0;
        const std::size_t known = origins.size();
        if (all) sooner_known = std::max(sooner_known, from(next + 1, m, reached_by(m), origins));
        origins.resize(known);
      }
      if (sooner_known > 0 && all)
        return std::max(sooner_known, from(next + 1, n, reached_by(n), origins));
      // Whoever knows it earlier ends earlier: of all that may be the first, the last is enough.
      if (all)
        marks = reached_by(n);
      else
        marks.go_on(gap(n));
      k = n;
      ++next;
    }
  }

  /// Domain of the reader of samples[s - 1]; of the way's beginning for 0.
  [[nodiscard]] const Domain& domain_at(std::size_t s) const {
    return p.domains[at(p.domain_of(s == 0 ? leaves_by(p, chain, samples, 0)
                                           : p.samples[at(samples[s - 1])].second))];
  }

  /// Whether a phase that is known before samples[next] matters behind it: the way comes back there, on the
  /// same clock all the way.
  [[nodiscard]] bool comes_back(std::size_t next) const {
    const int clock = domain_at(next + 1).clock;
    for (std::size_t later = next + 2; later <= samples.size(); ++later) {
      if (domain_at(later).clock != clock ||
          !followed(later - 1, p.samples[at(samples[later - 1])].second))
        return false;
      for (std::size_t s = next + 1; s-- > 0 && domain_at(s).clock == clock;)
        if (&domain_at(s) == &domain_at(later)) return true;
    }
    return false;
  }

  /// A result of another domain, `ends` after the way's beginning, just missed by activation n - 1
  /// of v, for any n. Not more than `enough` is asked for.
  [[nodiscard]] Tick at_any_phase(std::size_t next, int v, Tick ends, Tick enough,
                                  std::vector<Origin>& origins) {
    const Component& cv = p.components[at(p.component_of[at(v)])];
    const Tick apart = in_slow_time(cv.period, p.domains[at(cv.domain)].ppm);
    const std::size_t known = origins.size();
    Tick worst = 0;
    for (int n = 0; n < cv.jobs && worst < enough; ++n) {
      --returns;
      const Tick read = ends + apart - e(v, n - 1);
      origins.push_back({&cv, n, read, next + 1});
      worst = std::max(worst, from(next + 1, n, Marks({read, 0}), origins));
      origins.resize(known);
    }
    return worst;
  }

  /// `on_grid`: `ends` by the place on the clock alone, as `check` comes back there.
  [[nodiscard]] Tick across(std::size_t next, int v, Tick ends, Tick on_grid,
                            std::vector<Origin>& origins) {
    const Component& cv = p.components[at(p.component_of[at(v)])];
    const std::size_t known = origins.size();
    Tick least = kForeverAfter;
    // Back in a domain whose phase is known, on the same clock all the way: not later than by its
    // first activation that starts when the result is certainly there.
    for (std::size_t o = known; o-- > 0;) {
      const Origin origin = origins[o];
      if (p.domains[at(origin.component->domain)].clock != p.domains[at(cv.domain)].clock) break;
      if (origin.component->domain != cv.domain || !followed(next, v)) continue;
      // `check` goes from reader to reader on the grid. Where one begins before what it reads is released, it goes
      // back, and what drifts is twice in doubt there.
      const std::int64_t ppm = p.domains[at(cv.domain)].ppm;
      const Tick doubt = ppm == 0 ? 0
                                  : static_cast<Tick>(next + 1 - origin.samples) * 2 *
                                        (in_slow_time(latest, ppm) - latest);
      const std::int64_t n = first_reader(p, *origin.component, origin.k,
                                          on_grid - origin.after + doubt, v, e, most_e[next]);
      const Tick since =
          cv.phase + n * cv.period - origin.component->phase - origin.k * origin.component->period;
      // By how much that is after what began since `origin` is not known any more: the sooner one of
      // these began, the longer.
      const std::vector<Origin> later(origins.begin() + static_cast<std::ptrdiff_t>(o) + 1,
                                      origins.end());
      origins.resize(o + 1);
      least = from(next + 1, n, Marks({origin.after, since}), origins);
      origins.resize(o + 1);
      origins.insert(origins.end(), later.begin(), later.end());
      break;
    }
    Crossing& crossing = crossings[next];
    if (!crossing.comes_back) crossing.comes_back = comes_back(next);
    if (*crossing.comes_back) {
      if (returns > 0) return std::min(least, at_any_phase(next, v, ends, least, origins));
      if (least < kForeverAfter) return least;
    }
    // Once for all that come here: what is left does not depend on when.
    if (crossing.left == kNoTick) {
      std::vector<Origin> none;
      crossing.left = at_any_phase(next, v, 0, kForeverAfter, none);
    }
    return std::min(least, ends + crossing.left);
  }
};

}  // namespace

Tick least_distance(Tick length, std::int64_t ppm) {
  if (ppm == 0) return length;
  // A fast clock makes a distance shorter, a slow one makes one into the past longer.
  const Tick distance = length < 0 ? -length : length;
  return length - (in_slow_time(distance, ppm) - distance + 1);
}

Tick worst_case(const Problem& p, const Chain& chain, const Path& path, const Windows& w,
                bool urgent, const Releases& of) {
  const int leaves = leaves_by(p, chain, path.samples, 0);
  const Component& c = p.components[at(p.component_of[at(leaves)])];
  Way way{p, chain, path.samples, {p, w.d}, {p, w.e}, urgent ? p.urgent_by(leaves) : 0, {}, 0, {}};
  if (!path.samples.empty() &&
      std::ranges::any_of(p.domains, [](const Domain& d) { return d.ppm > 0 && d.part; }))
    way.latest = *std::max_element(w.e.begin(), w.e.end());
  way.crossings.resize(path.samples.size());
  for (const int s : path.samples) {
    const int v = p.samples[at(s)].second;
    const auto first = w.e.begin() + p.slot[at(v)];
    way.most_e.push_back(*std::max_element(first, first + p.jobs[at(v)]));
  }
  Tick worst = 0;
  std::vector<Way::Origin> origins;
  const Tick before = longest(c.phase - chain.offset, p.domains[at(c.domain)].ppm);
  const bool all = of.last - of.first + 1 >= c.jobs;
  for (std::int64_t n = all ? 0 : of.first; n <= (all ? c.jobs - 1 : of.last); ++n) {
    const std::int64_t k = n - floor_div(n, c.jobs) * c.jobs;
    origins.assign(1, {&c, k, before, 0});
    worst = std::max(worst, way.from(0, k, Marks({before, 0}), origins));
  }
  // A check may round what drifts once more at each sample.
  const auto drifts = [&](int s) {
    return p.domains[at(p.domain_of(p.samples[at(s)].second))].ppm > 0;
  };
  return worst + std::count_if(path.samples.begin(), path.samples.end(), drifts);
}

Tick worst_case(const Problem& p, const Chain& chain, const Windows& w, bool urgent) {
  Tick worst = 0;
  for (const Path& path : chain.paths)
    worst = std::max(worst, worst_case(p, chain, path, w, urgent));
  return worst;
}

}  // namespace xauto::solver::keys

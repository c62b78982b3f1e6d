// SPDX-License-Identifier: Apache-2.0
// A path visits components. In each, one activation is the first that surely knows the release:
//
//   late[n]  the most real time from the nominal release of the source's message to the nominal
//            release of that activation, where it is one of class n
//
// Of that several bounds are followed side by side, and the least counts at the end: each has kept the way's place on
// the clock since another instant, and all that drifts since then is added before it drifts. One begins at each reader,
// since the one before it was surely too early: sooner there, but who goes back on the clock later loses drift twice.
//
// From u of activation n to v, which samples it, on one clock: u ends by its key. v reads when it
// starts, which is not before its release + e. So the first activation m of v with
// (release m) + e_m >= (release n) + d_u knows it. On another clock, or where the phases repeat too
// late: v started last before u's end, by less than e_m-1 after its release; the next release comes
// a period later. Keys do not fall, so whoever knows it earlier ends earlier.
#include "solver/keys/check_chains.h"

#include <algorithm>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace xauto::solver::keys::checking {
namespace chains {

constexpr std::size_t kMaxClasses = 1'000'000;
constexpr std::int64_t kMaxWork = 50'000'000;  ///< a second
constexpr Ticks kUnreached = -4 * kMaxTicks;

/// Millionths of a tick, in which drift is exact: what is compared and added again and again is not rounded.
using Fine = __int128;
Fine fine(Ticks x) {
  return static_cast<Fine>(x) * kMillion;
}
Fine fine_most(Ticks x, std::int64_t ppm) {
  return static_cast<Fine>(x) * (kMillion + (x < 0 ? -ppm : ppm));
}

/// At most `real`, and `grid` on the clock's grid: what drifts together is added before it drifts.
struct Mark {
  Fine real = fine(kUnreached);
  Ticks grid = 0;
  [[nodiscard]] bool reached() const { return real > fine(kUnreached); }
};

/// What is at least as late as each, however far the grid goes on: most(x + y) <= most(x) + most(y). The
/// grid of the later one stays, since who goes back on it takes drift off again.
Mark later(Mark a, Mark b, std::int64_t ppm) {
  if (a.real + fine_most(a.grid, ppm) < b.real + fine_most(b.grid, ppm)) std::swap(a, b);
  return {std::max(a.real, b.real + fine_most(b.grid - a.grid, ppm)), a.grid};
}

/// However far the grid goes on, `b` is not later.
bool covers(const Mark& a, const Mark& b, std::int64_t ppm) {
  return b.real + fine_most(b.grid - a.grid, ppm) <= a.real;
}

/// One instant, which is at most each of some marks. None of them is always earlier than another one.
class Instant {
 public:
  Instant() = default;
  explicit Instant(const Mark& mark) : first_(mark) {}

  [[nodiscard]] bool reached() const { return first_.reached(); }

  template <class Visit>
  void each(const Visit& visit) const {
    visit(first_);
    for (const Mark& m : more_) visit(m);
  }

  /// The earliest, in a component of that drift.
  [[nodiscard]] Mark least(std::int64_t ppm) const {
    Mark best = first_;
    for (const Mark& m : more_)
      if (m.real + fine_most(m.grid, ppm) < best.real + fine_most(best.grid, ppm)) best = m;
    return best;
  }

  /// At most `mark`, too. One more than can be kept is not.
  void at_most(const Mark& mark, std::int64_t ppm) {
    if (covers(mark, first_, ppm)) return;
    if (std::ranges::any_of(more_, [&](const Mark& m) { return covers(mark, m, ppm); })) return;
    std::erase_if(more_, [&](const Mark& m) { return covers(m, mark, ppm); });
    if (covers(first_, mark, ppm))
      first_ = mark;
    else if (more_.size() < kMost)
      more_.push_back(mark);
  }

  void go_on(Ticks gap) {
    first_.grid += gap;
    for (Mark& m : more_) m.grid += gap;
  }

  /// However far the grid goes on, `b` is not later than `a`.
  friend bool covers(const Instant& a, const Instant& b, std::int64_t ppm) {
    bool all = true;
    a.each([&](const Mark& of_a) {
      bool any = false;
      b.each([&](const Mark& of_b) { any = any || covers(of_a, of_b, ppm); });
      all = all && any;
    });
    return all;
  }

 private:
  static constexpr std::size_t kMost = 7;
  Mark first_;
  std::vector<Mark> more_;
};

/// By class, the latest of some instants. Of most classes there is one; two of which neither covers the other
/// would lose drift as one.
class Late {
 public:
  explicit Late(std::size_t classes = 0) : first_(classes) {}

  [[nodiscard]] std::size_t size() const { return first_.size(); }

  void add(std::size_t n, const Instant& instant, std::int64_t ppm) {
    Instant& first = first_[n];
    if (!first.reached() || covers(instant, first, ppm)) {
      first = instant;
      return;
    }
    if (covers(first, instant, ppm)) return;
    auto& more = more_[n];
    if (std::ranges::any_of(more, [&](const Instant& l) { return covers(l, instant, ppm); }))
      return;
    std::erase_if(more, [&](const Instant& l) { return covers(instant, l, ppm); });
    if (more.size() < kMost)
      more.push_back(instant);
    else
      more.back() = Instant(later(more.back().least(ppm), instant.least(ppm), ppm));
  }

  /// `visit` sees all of class n.
  template <class Visit>
  void each(std::size_t n, const Visit& visit) const {
    if (!first_[n].reached()) return;
    visit(first_[n]);
    const auto more = more_.find(n);
    if (more == more_.end()) return;
    for (const Instant& l : more->second) visit(l);
  }

 private:
  static constexpr std::size_t kMost = 8;
  std::vector<Instant> first_;
  std::unordered_map<std::size_t, std::vector<Instant>> more_;
};

class Walk {
 public:
  Walk(const World& w, const ChainSpec& chain, bool urgent)
      : w_(w), chain_(chain), urgent_(urgent) {
    for (const auto& sample : w.app.samples) samples_.insert(sample);
    reads_.resize(w.app.xnodes.size());
    for (const auto& [u, v] : samples_) reads_[at(u)].push_back(v);
    visited_.assign(w.components.size(), 0);
    shortest_.resize(w.wcet.size());
    for (std::size_t i = 0; i < shortest_.size(); ++i) {
      Ticks least_us = kMaxTimeUs;
      for (const auto& of : w.app.xnodes[i].wcet_us)
        if (std::ranges::any_of(w.platform.xpus, [&](const Xpu& x) { return x.type == of.first; }))
          least_us = std::min(least_us, of.second);
      shortest_[i] = least_us * w.scale;
    }
  }

  Result<ChainProof> derive() {
    const SourceSpec& source = w_.app.sources[at(chain_.from)];
    for (std::size_t c = 0; c < w_.components.size(); ++c) {
      const Component& home = w_.components[c];
      std::vector<int> enters;
      for (const int x : home.xnodes)
        if (std::ranges::count(w_.app.xnodes[at(x)].sources, chain_.from) > 0) enters.push_back(x);
      if (enters.empty()) continue;
      const Ticks offset = source.offset_us * w_.scale;
      // Everything that an XNode waits for is on its shortest path, other sources included. Of any policy: without
      // this one's order.
      std::vector<Ticks> ends(w_.wcet.size(), kUnreached), after(w_.wcet.size(), 0);
      for (const int x : w_.order) {
        if (w_.component_of[at(x)] != static_cast<int>(c)) continue;
        Ticks ready = after[at(x)];
        for (const int s : w_.app.xnodes[at(x)].sources)
          ready =
              std::max(ready, (w_.app.sources[at(s)].offset_us + w_.app.sources[at(s)].jitter_us) *
                                  w_.scale);
        ends[at(x)] = ready + shortest_[at(x)];
        for (const int v : w_.hearers[at(x)]) after[at(v)] = std::max(after[at(v)], ends[at(x)]);
      }
      for (Ticks& end : ends) end -= offset;
      path_ = {source.name};
      first_ = static_cast<int>(c);
      Late begins(static_cast<std::size_t>(home.classes));
      const Mark begin{0, home.phi - offset};
      for (std::size_t n = 0; n < begins.size(); ++n) begins.add(n, Instant(begin), home.ppm);
      XAUTO_TRY(visit(static_cast<int>(c), enters, begins, ends));
    }
    if (proof_.path.empty())
      return fail(ErrorCode::kInvalid,
                  fmt::format("nothing leads from source '{}' to XNode '{}'", source.name,
                              w_.name(chain_.to)),
                  "chain '" + chain_.name + "'");
    proof_.derived_us = w_.us_up(worst_);
    proof_.own_bound_us = w_.us_up(std::max<Ticks>(bound_, 0));
    return proof_;
  }

 private:
  /// `ends`: [xnode of this component] no policy ends it earlier, in the worst execution.
  Status visit(int c, const std::vector<int>& enters, const Late& late,
               const std::vector<Ticks>& ends) {
    visited_[at(c)] = 1;
    std::vector<char> reached(w_.wcet.size(), 0);
    for (const int x : enters) reached[at(x)] = 1;
    path_.push_back(w_.name(enters.front()));
    for (const int x : w_.order) {
      if (!reached[at(x)]) continue;
      for (const int v : w_.hearers[at(x)]) reached[at(v)] = 1;
      if (x == chain_.to) arrive(c, late, ends[at(x)]);
      for (const int v : reads_[at(x)])
        if (!visited_[at(w_.component_of[at(v)])]) {
          path_.push_back(w_.name(x));
          XAUTO_TRY(sample(x, v, late, ends[at(x)]));
          path_.pop_back();
        }
    }
    path_.pop_back();
    visited_[at(c)] = 0;
    return {};
  }

  /// Its key, in what the release itself reaches by edges with its urgency.
  [[nodiscard]] Ticks due(int x, std::int64_t n) const {
    const Ticks d = w_.window(x, n).d;
    return urgent_ && w_.component_of[at(x)] == first_ && !w_.urgent[at(x)].empty()
               ? d - w_.components[at(first_)].urgent_by
               : d;
  }

  /// To the nominal release of what is marked, in a component of that drift.
  [[nodiscard]] static Fine value(const Mark& mark, const Component& c) {
    return mark.real + fine_most(mark.grid, c.ppm);
  }

  [[nodiscard]] static Fine value(const Instant& instant, const Component& c) {
    return value(instant.least(c.ppm), c);
  }

  void arrive(int c, const Late& late, Ticks bound) {
    bound_ = std::max(bound_, bound);
    for (std::size_t n = 0; n < late.size(); ++n)
      late.each(n, [&](const Instant& l) {
        const Ticks end = ceil_div(value(l, w_.components[at(c)]), kMillion) +
                          due(chain_.to, static_cast<std::int64_t>(n));
        if (!proof_.path.empty() && end <= worst_) return;
        worst_ = end;
        proof_.path = path_;
        proof_.path.push_back(w_.name(chain_.to));
      });
  }

  Status sample(int u, int v, const Late& late, Ticks bound) {
    const Component &from = w_.home(u), &to = w_.home(v);
    Late next;
    if (from.clock != to.clock ||
        (!follow(u, v, late, next) && !follow(u, v, of_own_classes(late, from), next)))
      any_phase(u, v, late, next);
    work_ += static_cast<std::int64_t>(late.size() + next.size() + w_.wcet.size());
    if (work_ > kMaxWork)
      return fail(ErrorCode::kUnavailable, "it has too many paths to follow all of them",
                  "chain '" + chain_.name + "'", "take out samples that it does not need");
    std::vector<Ticks> ends(w_.wcet.size(), kUnreached);
    ends[at(v)] = bound + shortest_[at(v)];
    for (const int p : w_.order)
      for (const int x : w_.hearers[at(p)])
        if (ends[at(p)] > kUnreached && x != v)
          ends[at(x)] = std::max(ends[at(x)], ends[at(p)] + shortest_[at(x)]);
    return visit(w_.component_of[at(v)], {v}, next, ends);
  }

  /// The phases to components before it are forgotten.
  [[nodiscard]] static Late of_own_classes(const Late& late, const Component& c) {
    Late own(static_cast<std::size_t>(c.classes));
    for (std::size_t n = 0; n < late.size(); ++n)
      late.each(n, [&](const Instant& l) { own.add(n % own.size(), l, c.ppm); });
    return own;
  }

  /// Phases are known. False: they repeat too late.
  bool follow(int u, int v, const Late& late, Late& next) {
    const Component &from = w_.home(u), &to = w_.home(v);
    const Ticks pattern = lcm(static_cast<Ticks>(late.size()) * from.period, to.pattern());
    if (pattern == 0 || pattern / from.period > static_cast<Ticks>(kMaxClasses) ||
        pattern / to.period > static_cast<Ticks>(kMaxClasses))
      return false;
    const Ticks classes = pattern / to.period;
    next = Late(static_cast<std::size_t>(classes));
    const Ticks latest = std::ranges::max(w_.windows[at(v)], {}, &Window::e).e;
    work_ += pattern / from.period;
    for (std::int64_t n = 0; n < pattern / from.period; ++n)
      late.each(static_cast<std::size_t>(n) % late.size(),
                [&](const Instant& l) { follow_one(u, v, n, l, latest, next); });
    return true;
  }

  /// From activation n of u, released by `so_far`.
  void follow_one(int u, int v, std::int64_t n, const Instant& so_far, Ticks latest, Late& next) {
    const Component &from = w_.home(u), &to = w_.home(v);
    const Ticks release = from.phi + n * from.period;
    const Ticks end = due(u, n) + w_.passes(u, v);
    const auto classes = static_cast<std::int64_t>(next.size());
    // The first that knows it with the least drift, up to the one that does with the most.
    const auto gap = [&](std::int64_t k) { return to.phi + k * to.period - release; };
    const Ticks reach = floor_div(static_cast<__int128>(end - latest) * kMillion,
                                  kMillion + (end > latest ? to.ppm : -to.ppm));
    std::int64_t m = floor_div(static_cast<__int128>(release) + reach - to.phi, to.period) - 1;
    while (most(gap(m), to.ppm) + w_.earliest(v, m) < end) ++m;
    for (;; ++m) {
      if (++work_ > kMaxWork) return;  // sample() says so
      Instant then = so_far;
      then.go_on(gap(m));
      // The reader before was too early, so it began before the end. That has no grid to go back on.
      then.at_most(
          {value(so_far, from) + fine(end - w_.earliest(v, m - 1)) + fine_most(to.period, to.ppm),
           0},
          to.ppm);
      const std::int64_t k = m % classes;
      next.add(static_cast<std::size_t>(k < 0 ? k + classes : k), then, to.ppm);
      if (least(gap(m), to.ppm) + w_.earliest(v, m) >= end) break;
    }
  }

  void any_phase(int u, int v, const Late& late, Late& next) const {
    Fine end = fine(kUnreached);
    for (std::size_t n = 0; n < late.size(); ++n)
      late.each(n, [&](const Instant& l) {
        end = std::max(end, value(l, w_.home(u)) +
                                fine(due(u, static_cast<std::int64_t>(n)) + w_.passes(u, v)));
      });
    const Component& to = w_.home(v);
    next = Late(static_cast<std::size_t>(to.classes));
    for (std::int64_t m = 0; m < to.classes; ++m) {
      const Mark mark{end - fine(w_.earliest(v, m - 1)) + fine_most(to.period, to.ppm), 0};
      next.add(static_cast<std::size_t>(m), Instant(mark), to.ppm);
    }
  }

  const World& w_;
  const ChainSpec& chain_;
  bool urgent_;
  int first_ = -1;  ///< component that the way begins in
  std::set<std::pair<int, int>> samples_;
  std::vector<std::vector<int>> reads_;
  std::vector<char> visited_;
  std::vector<Ticks> shortest_;  ///< [xnode] least WCET
  std::vector<std::string> path_;
  ChainProof proof_;
  Ticks worst_ = kUnreached, bound_ = 0;
  std::int64_t work_ = 0;
};

}  // namespace chains

Result<ChainProof> derive_chain(const World& w, std::size_t index, bool urgent) {
  return chains::Walk(w, w.app.chains[index], urgent).derive();
}

}  // namespace xauto::solver::keys::checking

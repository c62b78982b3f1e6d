// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/check_handover_shared.h"

#include <algorithm>
#include <numeric>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "solver/steady/check_handover_blocking.h"
#include "solver/steady/check_load.h"

namespace xauto::solver::steady::checking::shared {

/// Of all jobs around one S, so that sums of several clocks fit.
constexpr Ticks kMostWork = Ticks{1} << 57;
/// What lateness lets in may make all later, which lets in more.
constexpr int kMostRounds = 8;

/// C+ of a table's own envelope.
Ticks work_with_cost(const World& w, int xnode) {
  const Xpu& xpu = w.platform.xpus[at(w.policy.placements[at(xnode)].xpu)];
  return w.wcet[at(xnode)] + (xpu.preemptive ? xpu.preempt_us * w.scale : 0);
}

/// The most work of a clock on an XPU under one table whose windows lie in an interval of a length.
class Dbf {
 public:
  struct Span {
    Ticks begin, end, work;
  };
  /// One hyperperiod's windows. False: too many pairs.
  bool make(std::vector<Span> spans, Ticks hyperperiod, Ticks longest, std::int64_t& pairs) {
    steps_ = {{0, 0}};
    if (spans.empty()) return true;
    Ticks deepest = 0, turn = 0;
    for (Span& s : spans) {
      // All ends are of one turn, so those of the next one are later, however long windows are.
      const Ticks shift = floor_div(s.end, hyperperiod) * hyperperiod;
      s.begin -= shift;
      s.end -= shift;
      deepest = std::max(deepest, s.end - s.begin);
      turn += s.work;
    }
    std::ranges::sort(spans, {}, &Span::end);
    const Ticks until = deepest + hyperperiod;
    std::vector<std::pair<Ticks, Ticks>> higher;
    for (const Span& first : spans) {
      // From the first key after its begin on.
      const Ticks begin = first.begin;
      Ticks base = floor_div(begin - spans.back().end, hyperperiod) * hyperperiod, sum = 0;
      std::size_t step = 0;
      higher.clear();
      for (std::size_t k = 0; spans[k].end + base <= begin + until;) {
        if (--pairs < 0) return false;
        if (spans[k].begin + base >= begin) {
          const Ticks length = spans[k].end + base - begin;
          sum += spans[k].work;
          while (step + 1 < steps_.size() && steps_[step + 1].first <= length) ++step;
          if (sum > steps_[step].second) higher.emplace_back(length, sum);
        }
        if (++k == spans.size()) {
          k = 0;
          base += hyperperiod;
        }
      }
      if (higher.empty()) continue;
      steps_.insert(steps_.end(), higher.begin(), higher.end());
      keep_rising();
      pairs -= static_cast<std::int64_t>(steps_.size());
    }
    // An interval as long as all windows, and one hyperperiod: the longer one has just a turn more.
    const auto repeats = static_cast<std::size_t>(
        std::ranges::upper_bound(steps_, deepest, {}, &std::pair<Ticks, Ticks>::first) -
        steps_.begin());
    const std::size_t size = steps_.size() - repeats;
    while (steps_.back().first <= longest) {
      pairs -= static_cast<std::int64_t>(size);
      if (pairs < 0 || steps_.back().second > kMostWork) return false;
      for (std::size_t k = 0; k < size; ++k) {
        const auto [length, work] = steps_[steps_.size() - size];
        steps_.emplace_back(length + hyperperiod, work + turn);
      }
    }
    return true;
  }
  /// Lengths, and what may be in one of at least that; the first is 0 and nothing.
  [[nodiscard]] const std::vector<std::pair<Ticks, Ticks>>& steps() const { return steps_; }

 private:
  void keep_rising() {
    std::ranges::sort(steps_);
    std::size_t kept = 0;
    for (std::size_t k = 0; k < steps_.size(); ++k) {
      const auto [length, work] = steps_[k];
      if (kept > 0 && work <= steps_[kept - 1].second) continue;
      if (kept > 0 && steps_[kept - 1].first == length) --kept;
      steps_[kept++] = {length, work};
    }
    steps_.resize(kept);
  }
  std::vector<std::pair<Ticks, Ticks>> steps_ = {{0, 0}};
};

struct Item {
  Ticks alpha = 0, key = 0;  ///< late and early
  Ticks due = 0;             ///< the key, or later
  Ticks work = 0;
  Ticks before = 0;  ///< λ(alpha) of the set that is looked at, once it is known
};

/// When a job of q is ready, and has ended, if nothing is late.
struct When {
  Ticks alpha = 0, key = 0;  ///< late and early
  Ticks due = 0;             ///< δ; the key, or later
  bool waits = false;        ///< for p, directly or through others, maybe until after its `a`
  bool wrong = false;        ///< `a` is not before the key
  [[nodiscard]] bool is_past_key() const { return due > key; }
};

/// The first jobs of q of an XNode: all of those that wait for p are among them.
struct First {
  std::int64_t n = 0;
  std::vector<When> jobs;
};

/// The kinds of share: of which tables dbf is.
enum class Kind : std::uint8_t { kOfQ, kOfP, kOfBoth };

/// G of both tables, as far as a kind has them.
struct Overruns {
  Overrun of_p, of_q;
};

/// Of one XPU.
struct Lane {
  bool shared = false;
  Kind kind = Kind::kOfQ;             ///< where it is shared
  Dbf dbf_p, dbf_q;                   ///< those that its kind has
  std::vector<Item> items;            ///< by alpha
  std::size_t known = 0;              ///< of them have `before`
  std::vector<Item> past;             ///< those of them that are ready no sooner than their key
  const Overruns* overrun = nullptr;  ///< where it is shared and does not preempt
  bool at_low = false;                ///< some job may have its key just after t_lo
  bool blocks = false;                ///< it is not shared, and does not preempt
  std::vector<InTheWay> in_the_way;   ///< there, by `opens`
  std::vector<Hindered> hindered;     ///< there, by key, but for those
  std::vector<Hindered> waiting;      ///< that are ready no sooner than that
  Ticks lag = 0;                      ///< w(L)
  /// g of a length, and of any.
  [[nodiscard]] Ticks beside(Ticks length) const {
    if (kind == Kind::kOfQ) return overrun->of_q.at(length);
    if (kind == Kind::kOfP) return overrun->of_p.at(length);
    return std::max(overrun->of_p.at(length / 2), overrun->of_q.at(length / 2));
  }
  [[nodiscard]] Ticks most_beside() const {
    return std::max(overrun->of_p.largest(), overrun->of_q.largest());
  }
};

/// dbf of lengths that rise from call to call. Steps may be many more than calls, so it leaps.
class Rising {
 public:
  explicit Rising(const Dbf& of) : steps_(of.steps()) {}
  Ticks at(Ticks length) {
    const auto leap = [&](std::size_t by) {
      if (by >= steps_.size() - step_ || steps_[step_ + by].first > length) return false;
      step_ += by;
      return true;
    };
    std::size_t by = 1;
    while (leap(by)) by *= 2;
    while (by /= 2) leap(by);
    return steps_[step_].second;
  }
  [[nodiscard]] std::size_t step() const { return step_; }

 private:
  const std::vector<std::pair<Ticks, Ticks>>& steps_;
  std::size_t step_ = 0;
};

/// f(x, y) of a lane for one y, and for x that fall from call to call.
class Share {
 public:
  Share(const Lane& lane, const Lateness& around, Ticks blur, Ticks y)
      : lane_(lane),
        before_(around.before),
        change_(around.change),
        blur_(blur),
        y_(y),
        p_sooner_(lane.dbf_p),
        p_(lane.dbf_p),
        q_(lane.dbf_q) {}

  /// No more than f. It is f, but for the third kind: there it has p's work for the first S', and
  /// q's for the last one.
  Ticks at_least(Ticks x) {
    if (lane_.kind == Kind::kOfQ) return q_.at(y_ - x - 2 * blur_);
    if (lane_.kind == Kind::kOfP) return p_.at(y_ - x - 2 * blur_);
    return p_sooner_.at(std::min(y_, before_) - x - 2 * blur_) + of_q(x);
  }
  /// f of the third kind. With a later S' p's part does not fall, and q's does not rise. So it is
  /// least for the last S', or for one just before p's part rises. S' is a real number: there q's
  /// part is what it is where p's rises, since dbf is the same from a step on.
  Ticks of_both(Ticks x, std::int64_t& pairs) {
    Ticks least = p_.at(std::min(y_, change_) - x - 2 * blur_) + of_q(x);
    const auto& p = lane_.dbf_p.steps();
    Rising q = q_;
    for (std::size_t step = p_.step(); step > 0; --step) {
      const Ticks rises = x + 2 * blur_ + p[step].first;
      if (rises <= before_) break;
      least = std::min(least, p[step - 1].second + q.at(y_ - rises - 2 * blur_));
      --pairs;
    }
    return least;
  }

 private:
  Ticks of_q(Ticks x) { return q_.at(y_ - std::max(x, change_) - 2 * blur_); }

  const Lane& lane_;
  Ticks before_, change_, blur_, y_;
  Rising p_sooner_, p_, q_;
};

class Bound {
 public:
  Bound(const Question& ask, std::int64_t& pairs, Cluster& of)
      : ask_(ask), p_(ask.both.p), q_(ask.both.q), pairs_(pairs), of_(of), waits_(p_) {}

  void run(int percent) {
    if (!acceptable(percent)) return;
    find_sets();
    for (const OfClock& clock : of_.clocks)
      if (!scan(clock)) return;
    blur_instants();
    if (!some_block_) {
      derive(percent);
      return;
    }
    // All that follows from some slack holds. Who is in the way adds less where σ is less: so λ is least with
    // the least σ. But with a larger one lateness may fall sooner.
    if (!derive(1)) return;
    const std::vector<OfClock> least = of_.clocks;
    Ticks soonest = of_.settles;
    for (const int more : {2, 3, 5, 8}) {
      if (more > percent || !derive(more)) break;
      soonest = std::min(soonest, of_.settles);
    }
    of_.clocks = least;
    of_.settles = soonest;
    of_.why.clear();
  }

 private:
  /// λ, Λ and when all is over, from so much slack.
  bool derive(int percent) {
    of_.settles = 0;
    lags_.assign(users_.size(), 0);
    for (int round = 0; round < kMostRounds; ++round) {
      if (!find_overruns(percent)) return false;
      find_slope(percent);
      reaches_.clear();
      for (std::size_t k = 0; k < of_.clocks.size(); ++k)
        if (!walk(k)) return false;
      if (!raise_lags()) {
        settle();
        return of_.why.empty();
      }
    }
    return refuse("lateness lets in what makes all later again, on XPUs that do not preempt");
  }

  struct Grid {
    std::vector<Ticks> releases;  ///< of a hyperperiod
    Ticks deepest = 0;            ///< the largest d
    Ticks latest = 0;             ///< and a
    Ticks keys_of_p = 0;
    Ticks meets_p = 0;  ///< M, as far as it is this clock's; in its own time
  };

  bool refuse(std::string why) {
    of_.why = std::move(why);
    return false;
  }
  bool too_much() { return refuse("that takes more work than is looked at"); }

  [[nodiscard]] int xpu_of(bool of_q, int xnode) const {
    return ask_.both.of(of_q).policy.placements[at(xnode)].xpu;
  }
  /// Its `a`, or a little more.
  [[nodiscard]] Ticks a_of(const Window& window) const { return window.a + (ask_.coarse ? 1 : 0); }

  template <typename Visit>
  void each_xnode(int clock, const Visit& visit) const {
    for (const Component& c : p_.components)
      if (c.clock == clock)
        for (const int i : c.xnodes) visit(c, i);
  }

  // ------------------------------------------------------------------------------------- refusals

  bool acceptable(int percent) {
    const auto& xpus = p_.platform.xpus;
    users_.assign(xpus.size(), {});
    for (const OfClock& clock : of_.clocks) {
      each_xnode(clock.clock, [&](const Component& /*c*/, int i) {
        for (const bool of_q : {false, true}) users_[at(xpu_of(of_q, i))].insert(clock.clock);
      });
    }
    kind_.assign(xpus.size(), Kind::kOfQ);
    for (std::size_t m = 0; m < xpus.size(); ++m) {
      if (users_[m].empty()) continue;
      some_block_ = some_block_ || !xpus[m].preemptive;
      if (users_[m].size() < 2) continue;
      bool more = true, less = true;  // in q
      for (const OfClock& clock : of_.clocks) {
        __int128 work[2] = {0, 0};
        each_xnode(clock.clock, [&](const Component& c, int i) {
          for (const bool of_q : {false, true})
            if (xpu_of(of_q, i) == static_cast<int>(m))
              work[of_q ? 1 : 0] += static_cast<__int128>(work_with_cost(ask_.both.of(of_q), i)) *
                                    (clock.hyperperiod / c.period);
        });
        more = more && work[1] >= work[0];
        less = less && work[1] <= work[0];
      }
      if (!more) kind_[m] = less ? Kind::kOfP : Kind::kOfBoth;
    }
    if (percent == 0) return refuse("both tables leave less than 1 % of an XPU");
    return true;
  }

  // ----------------------------------------------------------------------------------------- sets

  /// Who feeds whom, and R(m) of each XPU that the cluster uses.
  void find_sets() {
    std::vector<std::set<int>>& fed_by = fed_by_;
    fed_by.assign(users_.size(), {});
    // Jobs of both tables may wait for one of the same table, and those of q for one of p.
    const auto waits = [&](int i, int other) {
      for (const bool of_q : {false, true}) fed_by[at(xpu_of(of_q, i))].insert(xpu_of(of_q, other));
    };
    const auto waits_for_p = [&](int i, int other) {
      fed_by[at(xpu_of(true, i))].insert(xpu_of(false, other));
    };
    for (const OfClock& clock : of_.clocks)
      each_xnode(clock.clock, [&](const Component& /*c*/, int i) {
        for (const auto& [u, transfer] : p_.before[at(i)]) waits(i, u);
        waits_for_p(i, i);
        if (!p_.entry[at(i)]) return;
        for (const int x : p_.module_xnodes[at(p_.module_of[at(i)])]) {
          waits(i, x);
          waits_for_p(i, x);
        }
      });
    of_.set_of.resize(users_.size());
    for (std::size_t m = 0; m < users_.size(); ++m) {
      if (users_[m].empty()) continue;
      std::vector<int> set = {static_cast<int>(m)};
      for (std::size_t k = 0; k < set.size(); ++k)
        for (const int feeder : fed_by[at(set[k])])
          if (std::ranges::count(set, feeder) == 0) set.push_back(feeder);
      std::ranges::sort(set);
      const auto known = std::ranges::find(of_.sets, set);
      of_.set_of[m] = static_cast<std::size_t>(known - of_.sets.begin());
      if (known == of_.sets.end()) of_.sets.push_back(std::move(set));
    }
    // What L is of: m itself only where a message takes time there.
    for (std::size_t m = 0; m < users_.size(); ++m) fed_by[m].erase(static_cast<int>(m));
    for (const OfClock& clock : of_.clocks)
      each_xnode(clock.clock, [&](const Component& /*c*/, int i) {
        for (const bool of_q : {false, true})
          for (const auto& [u, transfer] : ask_.both.of(of_q).before[at(i)])
            if (transfer > 0 && xpu_of(of_q, u) == xpu_of(of_q, i))
              fed_by[at(xpu_of(of_q, i))].insert(xpu_of(of_q, i));
      });
  }

  // ------------------------------------------------------------------------------------- blocking

  [[nodiscard]] bool blocks(std::size_t m) const {
    return !users_[m].empty() && !p_.platform.xpus[m].preemptive;
  }
  [[nodiscard]] Drift drift_of(const OfClock& of) const {
    return {p_.app.clocks[at(of.clock)].ppm};
  }
  /// Both for a job of p, as it may be after t.
  [[nodiscard]] Ticks work_in_the_way(bool of_q, int i) const {
    return of_q ? q_.wcet[at(i)] : ask_.both.larger[at(i)];
  }

  /// Whether L of some XPU that does not preempt is less than what has been found. Then it is raised.
  bool raise_lags() {
    bool raised = false;
    for (std::size_t m = 0; m < users_.size(); ++m) {
      if (!blocks(m)) continue;
      for (const int feeder : fed_by_[m]) {
        Ticks sum = 0;
        for (const OfClock& of : of_.clocks) sum += of.largest[of_.set_of[at(feeder)]];
        if (sum <= lags_[m]) continue;
        lags_[m] = sum;
        raised = true;
      }
    }
    return raised;
  }

  /// β, and M with it.
  void blur_instants() {
    if (!some_block_) return;
    Ticks blur = 0;
    for (std::size_t k = 0; k < of_.clocks.size(); ++k) {
      const Reach r = reach_of(k);
      blur = std::max(blur, most(2 * r.blur, r.drift.ppm));
    }
    beta_ = blur;
    meets_p_ += blur;
  }

  /// B, and dbf of both tables in real time as far as that matters, of an XPU that clocks share.
  struct Beside {
    Stairs of_p, of_q;
    std::vector<Stairs> of_q_by_clock;
    LongestInTheWay all;
    std::vector<InTheWayOfQ> in_q;
  };
  bool find_beside(std::size_t m, Beside& beside) {
    for (std::size_t k = 0; k < of_.clocks.size(); ++k)
      for (const bool of_q : {false, true}) {
        bool fits = true;
        if (!each_window(of_.clocks[k], of_q, m, [&](Ticks release, const Window& z, int i) {
              const Ticks work = work_in_the_way(of_q, i);
              beside.all.add(z.d - z.e, work);
              if (!of_q || !fits) return;
              beside.in_q.push_back({k, z.d - z.e, work, 0});
              fits = while_in_the_way(m, k, i, release, beside.in_q.back().of_its_own);
            }))
          return false;
        if (!fits) return false;
      }
    std::ranges::sort(beside.in_q);
    beside.in_q.erase(std::unique(beside.in_q.begin(), beside.in_q.end()), beside.in_q.end());
    beside.all.sort(lags_[m] + beta_);
    for (const OfClock& of : of_.clocks)
      for (const bool of_q : {false, true}) {
        std::vector<RealWindow> windows;
        if (!each_window(of, of_q, m, [&](Ticks release, const Window& window, int i) {
              windows.push_back(
                  {release, a_of(window), window.d, work_with_cost(ask_.both.of(of_q), i)});
            }))
          return false;
        Stairs demand;
        if (!real_demand(windows, of.hyperperiod, drift_of(of).ppm, beside.all.end(), pairs_,
                         demand))
          return false;
        Stairs& sum = of_q ? beside.of_q : beside.of_p;
        sum = sum_of(sum, demand);
        if (of_q) beside.of_q_by_clock.push_back(std::move(demand));
      }
    return true;
  }

  /// W: of q and the clock of the job of `xnode` that is in the way. False: too many pairs.
  bool while_in_the_way(std::size_t m, std::size_t k, int xnode, Ticks release, Ticks& work) {
    const OfClock& of = of_.clocks[k];
    const Reach r = reach_of(k);
    const Component& home = p_.home(xnode);
    const Window& z = q_.window(xnode, (release - home.phi) / home.period);
    const Ticks lag = lags_[m];
    each_xnode(of.clock, [&](const Component& c, int i) {
      if (xpu_of(true, i) != static_cast<int>(m)) return;
      const Ticks from = release - r.drift.longest(grids_[k].deepest + lag) - 1;
      const Ticks until = release + r.drift.longest(z.d) + 1;
      for (std::int64_t n = ceil_div(from - c.phi, c.period); c.phi + n * c.period <= until; ++n) {
        if (--pairs_ < 0) return;
        const Ticks other = c.phi + n * c.period, shift = other - release;
        const Window& window = q_.window(i, n);
        if (most(shift, r.drift.ppm) + a_of(window) < z.e - lag ||
            least(shift, r.drift.ppm) + window.d >= z.d ||
            window.d - a_of(window) >= z.d - z.e + lag)
          continue;
        if ((i == xnode && shift == 0) || waits_(xnode, release, i, other)) continue;
        work += work_with_cost(q_, i);
      }
    });
    return pairs_ >= 0;
  }

  /// Of an XPU of one clock: whether q leaves a percentage beside what is in the way.
  bool one_clock_leaves(std::size_t m, int percent) {
    for (std::size_t k = 0; k < of_.clocks.size(); ++k) {
      const OfClock& of = of_.clocks[k];
      if (!users_[m].contains(of.clock)) continue;
      const Reach r = reach_of(k);
      std::vector<InTheWay> all;
      if (!each_window(of, true, m, [&](Ticks release, const Window& window, int i) {
            all.push_back(in_the_way(r.drift, release, window, i, work_in_the_way(true, i)));
          }))
        return false;
      OneLeaves leaves(all, waits_, of.hyperperiod, r.drift.ppm, r.drift.longest(lags_[m]),
                       r.deepest + 2 * r.blur);
      if (!leaves(percent, pairs_)) return false;
    }
    return true;
  }
  [[nodiscard]] InTheWay in_the_way(const Drift& drift, Ticks release, const Window& window,
                                    int xnode, Ticks work) const {
    return {xnode,
            release,
            release + drift.soon(window.e),
            release + drift.late(a_of(window)),
            release + drift.soon(window.d),
            release + drift.late(window.d),
            work};
  }

  /// G of each XPU that clocks share and that does not preempt. False: so much slack is not left on all that
  /// do not preempt.
  bool find_overruns(int percent) {
    std::vector<Beside> beside(users_.size());
    for (std::size_t m = 0; m < users_.size(); ++m)
      if (blocks(m) && users_[m].size() > 1 && !find_beside(m, beside[m])) return too_much();
    const auto fails = [&](std::size_t m) {
      if (!blocks(m)) return false;
      const Beside& of = beside[m];
      return users_[m].size() > 1
                 ? !leaves_beside(of.of_q_by_clock, of.of_q, of.in_q, lags_[m], percent, pairs_)
                 : !one_clock_leaves(m, percent);
    };
    for (std::size_t m = 0; m < users_.size(); ++m) {
      const bool refused = fails(m);
      if (pairs_ < 0) return too_much();
      if (refused)
        return refuse(p_.platform.xpus[m].id +
                      " does not preempt, and less than 1 % of it is left beside what may be in "
                      "the way");
    }
    overruns_.assign(users_.size(), {});
    for (std::size_t m = 0; m < users_.size(); ++m) {
      if (!blocks(m) || users_[m].size() < 2) continue;
      const Beside& of = beside[m];
      if (kind_[m] != Kind::kOfP) overruns_[m].of_q = Overrun(of.of_q, of.all, percent);
      if (kind_[m] != Kind::kOfQ) overruns_[m].of_p = Overrun(of.of_p, of.all, percent);
    }
    return true;
  }

  /// The windows of a hyperperiod. False: too many.
  template <typename Visit>
  bool each_window(const OfClock& of, bool of_q, std::size_t m, const Visit& visit) {
    const World& w = ask_.both.of(of_q);
    bool fits = true;
    each_xnode(of.clock, [&](const Component& c, int i) {
      if (w.policy.placements[at(i)].xpu != static_cast<int>(m)) return;
      pairs_ -= of.hyperperiod / c.period;
      fits = fits && pairs_ >= 0;
      for (std::int64_t n = 0; fits && n < of.hyperperiod / c.period; ++n)
        visit(c.phi + n * c.period, w.window(i, n), i);
    });
    return fits;
  }

  // ---------------------------------------------------------------------------- the jobs of one S

  /// Activation n of q, as long as it waits for nothing of p.
  [[nodiscard]] When when_alone(const Component& c, int i, std::int64_t n,
                                const Drift& drift) const {
    const Window& window = q_.window(i, n);
    const Ticks release = c.phi + n * c.period;
    const Ticks alpha = release + drift.late(a_of(window)), key = release + drift.soon(window.d);
    return {alpha, key, key, false, alpha >= key};
  }
  [[nodiscard]] When when(const Component& c, int i, std::int64_t n, const Drift& drift) const {
    const First& first = first_[at(i)];
    const auto k = static_cast<std::size_t>(n - first.n);
    return k < first.jobs.size() ? first.jobs[k] : when_alone(c, i, n, drift);
  }

  /// α and δ of activation n of q, where those before it, and those that it waits for, are known.
  When when_of(const Component& c, int i, std::int64_t n, std::int64_t first, const Drift& drift) {
    When of = when_alone(c, i, n, drift);
    const Window& window = q_.window(i, n);
    const Ticks release = c.phi + n * c.period, by = a_of(window);
    const Ticks own = of.alpha;
    // What has ended by `a`, whatever the clock does, does not matter.
    const auto wait_until = [&](Ticks instant) {
      if (instant <= release + drift.soon(by)) return;
      of.alpha = std::max(of.alpha, instant);
      of.waits = true;
    };
    const auto wait_for_p = [&](std::int64_t lag, Ticks length) {
      if (length <= least(lag * c.period, drift.ppm) + by) return;
      of.alpha = std::max(of.alpha, release - lag * c.period + drift.late(length));
      of.waits = true;
    };
    if (n == first) {
      const Window& before = p_.window(i, n - 1);
      const bool larger = before.d > least(c.period, drift.ppm) + window.d;
      wait_for_p(1, xpu_of(false, i) != xpu_of(true, i) || larger ? before.d : a_of(before));
    } else if (const When& before = first_[at(i)].jobs.back(); before.waits) {
      wait_until(before.alpha);
    }
    const auto found = [&](int other, std::int64_t m) -> const When& {
      --pairs_;
      return first_[at(other)].jobs[at(static_cast<int>(m - first))];
    };
    for (const auto& [u, transfer] : q_.before[at(i)])
      if (const When& sooner = found(u, n); sooner.is_past_key())
        wait_until(sooner.due + drift.longest(transfer));
    const int module = p_.module_of[at(i)];
    const std::int64_t lag = p_.in_flight[at(module)];
    if (p_.entry[at(i)]) {
      for (const int x : p_.module_xnodes[at(module)]) {
        if (n - lag < first)
          wait_for_p(lag, p_.window(x, n - lag).d);
        else if (const When& sooner = found(x, n - lag); sooner.is_past_key())
          wait_until(sooner.due);
      }
    }
    if (of.alpha > own) of.wrong = false;
    if (of.alpha >= of.key && !of.wrong) of.due = of.alpha + drift.longest(window.d - by);
    return of;
  }

  /// All jobs of q that wait for p, for one S. What is released after all that they wait for waits
  /// for nothing, so this ends.
  bool find_first(const OfClock& of, Ticks change, const Grid& grid, const Drift& drift) {
    first_.assign(p_.wcet.size(), {});
    const Ticks most = change + deepest_of(grid, drift) + 2 * of.hyperperiod;
    for (const Component& c : p_.components) {
      if (c.clock != of.clock) continue;
      const std::set<int> members(c.xnodes.begin(), c.xnodes.end());
      std::vector<int> order;
      for (const int i : p_.order)
        if (members.contains(i)) order.push_back(i);
      const std::int64_t first = ceil_div(change - c.phi, c.period);
      for (const int i : order) first_[at(i)].n = first;
      Ticks latest = change + drift.late(grid.keys_of_p);
      for (std::int64_t n = first; c.phi + n * c.period <= latest; ++n)
        for (const int i : order) {
          if (--pairs_ < 0) return too_much();
          const When when = when_of(c, i, n, first, drift);
          if (when.waits && c.phi + n * c.period > most)
            return refuse(
                fmt::format("XNode '{}' may still wait for the table before when that should have "
                            "been over",
                            p_.name(i)));
          if (when.waits) latest = std::max({latest, when.alpha, when.due});
          first_[at(i)].jobs.push_back(when);
        }
    }
    return true;
  }

  /// The releases of a clock, M, and the longest windows.
  bool scan(const OfClock& of) {
    const Drift drift{p_.app.clocks[at(of.clock)].ppm};
    Grid& grid = grids_.emplace_back();
    std::set<Ticks> releases;
    bool fits = true;
    each_xnode(of.clock, [&](const Component& c, int i) {
      pairs_ -= of.hyperperiod / c.period;
      fits = fits && pairs_ >= 0;
      for (std::int64_t n = 0; fits && n < of.hyperperiod / c.period; ++n) {
        const Ticks at_phi = c.phi + n * c.period;
        releases.insert(at_phi - floor_div(at_phi, of.hyperperiod) * of.hyperperiod);
      }
      for (const bool of_q : {false, true})
        for (const Window& window : ask_.both.of(of_q).windows[at(i)]) {
          grid.deepest = std::max({grid.deepest, window.d, a_of(window)});
          grid.latest = std::max(grid.latest, a_of(window));
          if (!of_q) grid.keys_of_p = std::max(grid.keys_of_p, window.d);
          if (!of_q) grid.meets_p = std::max(grid.meets_p, drift.late(a_of(window)));
          if (!of_q && some_block_) grid.meets_p = std::max(grid.meets_p, drift.late(window.d));
        }
    });
    if (!fits) return too_much();
    grid.releases.assign(releases.begin(), releases.end());
    Ticks before = grid.releases.back() - of.hyperperiod;
    for (const Ticks change : grid.releases) {
      if (!find_first(of, change, grid, drift)) return false;
      for (const First& first : first_)
        for (const When& when : first.jobs) {
          if (when.waits) grid.meets_p = std::max(grid.meets_p, when.alpha - before);
          if (when.is_past_key()) grid.meets_p = std::max(grid.meets_p, when.due - before);
        }
      before = change;
    }
    meets_p_ = std::max(meets_p_, most(grid.meets_p, drift.ppm));
    return true;
  }

  /// τ: from S + E on lateness falls by so much of what time passes. It is σ where nobody waits for a
  /// message. Who does so is late by what its predecessor was, a transfer before its α: its window, w,
  /// has to make up for that time, too. So it is σ w / (w + transfer) at least.
  void find_slope(int percent) {
    __int128 window = 1, transfer = 0;
    for (const OfClock& clock : of_.clocks)
      each_xnode(clock.clock, [&](const Component& /*c*/, int i) {
        Ticks longest = 0, shortest = kMaxTicks;
        for (const auto& [u, message] : q_.before[at(i)]) longest = std::max(longest, message);
        for (const Window& w : q_.windows[at(i)]) shortest = std::min(shortest, w.d - a_of(w));
        if (longest * window <= transfer * shortest) return;
        window = shortest;
        transfer = longest;
      });
    slope_ = window * percent;
    slope_of_ = (window + transfer) * 100;
    if (transfer == 0) {
      slope_ = percent;
      slope_of_ = 100;
    }
  }

  /// D
  static Ticks deepest_of(const Grid& grid, const Drift& drift) {
    return grid.deepest + 2 * (drift.late(grid.deepest) - grid.deepest);
  }

  /// D, b and M of a clock, in its own time.
  struct Reach {
    Drift drift;
    Ticks blur = 0, deepest = 0, meets_p = 0, back = 0, ahead = 0;
  };
  [[nodiscard]] Reach reach_of(std::size_t k) const {
    const OfClock& of = of_.clocks[k];
    Reach r{{p_.app.clocks[at(of.clock)].ppm}};
    r.blur = r.drift.late(grids_[k].deepest) - grids_[k].deepest;
    r.deepest = deepest_of(grids_[k], r.drift);
    for (std::size_t other = 0; other < grids_.size(); ++other) {
      const std::int64_t ppm = p_.app.clocks[at(of_.clocks[other].clock)].ppm;
      r.meets_p = std::max(r.meets_p,
                           other == k ? grids_[k].meets_p + r.drift.longest(beta_)
                                      : r.drift.longest(most(grids_[other].meets_p, ppm) + beta_));
    }
    r.back = r.deepest + 2 * of.hyperperiod + 2 * r.blur;
    r.ahead = r.deepest + r.meets_p + 2 * of.hyperperiod + 2 * r.blur;
    return r;
  }

  /// All jobs that one has to look at.
  bool make_items(const OfClock& of, const Reach& r, const Grid& grid, Lateness& around) {
    if (!find_first(of, around.change, grid, r.drift)) return false;
    const Ticks first = around.low - r.back, last = around.change + r.ahead;
    Ticks work = 0;
    int wrong = -1;
    bool fits = true;
    for (Lane& lane : lanes_) {
      lane.items.clear();
      lane.past.clear();
      lane.in_the_way.clear();
      lane.hindered.clear();
      lane.waiting.clear();
      lane.at_low = false;
    }
    const auto add = [&](bool of_q, int i, std::int64_t n, const When& when, Ticks takes) {
      Lane& lane = lanes_[at(xpu_of(of_q, i))];
      const Component& home = p_.home(i);
      const Ticks release = home.phi + n * home.period;
      const Ticks key_late = release + r.drift.late(ask_.both.of(of_q).window(i, n).d);
      lane.at_low = lane.at_low || (when.key <= around.low && key_late > around.low);
      if (lane.blocks && std::max(key_late, when.due) > around.low)
        (when.is_past_key() ? lane.waiting : lane.hindered)
            .push_back({i, release, when.key, key_late, when.due});
      // On a shared XPU it goes before all jobs of other clocks that lie between its key and its alpha.
      if (when.wrong || (lane.shared && when.is_past_key())) wrong = i;
      work += takes;
      fits = --pairs_ >= 0 && work <= kMostWork;
      lane.items.push_back({when.alpha, when.key, when.due, takes});
      if (when.is_past_key()) lane.past.push_back(lane.items.back());
      return fits && wrong < 0;
    };
    each_xnode(of.clock, [&](const Component& c, int i) {
      if (!fits || wrong >= 0) return;
      const Ticks in_p = work_with_cost(p_, i), in_q = work_with_cost(q_, i);
      const Ticks more = ask_.both.larger[at(i)] - p_.wcet[at(i)];
      std::int64_t n = floor_div(first - c.phi - r.drift.late(grid.latest), c.period);
      for (; c.phi + n * c.period < around.change; ++n) {
        const Ticks release = c.phi + n * c.period;
        const Window& window = p_.window(i, n);
        const Ticks alpha = release + r.drift.late(a_of(window));
        const Ticks key = release + r.drift.soon(window.d);
        const bool as_in_p = release + r.drift.late(window.d) <= around.low;
        if (alpha >= first &&
            !add(false, i, n, {alpha, key, key, false, alpha >= key}, as_in_p ? in_p : in_p + more))
          return;
      }
      const Lane& lane = lanes_[at(xpu_of(true, i))];
      const Ticks until = last + (lane.blocks ? lane.lag : 0);
      for (n = ceil_div(around.change - c.phi, c.period);; ++n) {
        const When of_q = when(c, i, n, r.drift);
        if (of_q.is_past_key()) around.dues[{i, n}] = of_q.due;
        if (of_q.key > until + 4 * r.blur) return;  // what drifts may have keys that fall
        if (of_q.key <= until && !add(true, i, n, of_q, in_q)) return;
      }
    });
    if (!fits) return too_much();
    if (wrong >= 0)
      return refuse(
          fmt::format("XNode '{}' may be ready no sooner than its key, so little is known of its "
                      "clock",
                      p_.name(wrong)));
    for (Lane& lane : lanes_) {
      std::ranges::sort(lane.items, {}, &Item::alpha);
      std::ranges::sort(lane.hindered, {}, &Hindered::key);
    }
    return find_in_the_way(of, r, around);
  }

  /// Those that begin by the last x + w(L), whatever their keys are.
  bool find_in_the_way(const OfClock& of, const Reach& r, const Lateness& around) {
    each_xnode(of.clock, [&](const Component& c, int i) {
      for (const bool of_q : {false, true}) {
        Lane& lane = lanes_[at(xpu_of(of_q, i))];
        if (!lane.blocks) continue;
        const Ticks last = last_x_alone(around, r) + lane.lag;
        const std::int64_t first_of_q = ceil_div(around.change - c.phi, c.period);
        std::int64_t n =
            of_q ? first_of_q : floor_div(around.low - r.deepest - r.blur - c.phi, c.period);
        for (; (of_q || n < first_of_q) && c.phi + n * c.period <= last; ++n) {
          if (--pairs_ < 0) return;
          const Ticks release = c.phi + n * c.period;
          InTheWay z = in_the_way(r.drift, release, ask_.both.of(of_q).window(i, n), i,
                                  work_in_the_way(of_q, i));
          if (of_q) z.alpha = when(c, i, n, r.drift).alpha;
          if (z.opens <= last && z.key_late > around.low) lane.in_the_way.push_back(z);
        }
      }
    });
    for (Lane& lane : lanes_) std::ranges::sort(lane.in_the_way, {}, &InTheWay::opens);
    return pairs_ >= 0 || too_much();
  }

  // --------------------------------------------------------------------------------------- λ

  /// On an XPU of one clock each x is before it.
  [[nodiscard]] static Ticks last_x_alone(const Lateness& around, const Reach& r) {
    return around.before + r.meets_p + 1;
  }

  /// Who may have its key at y, or its due.
  [[nodiscard]] static std::vector<const Hindered*> hindered_at(const Lane& lane,
                                                                const Lateness& around, Ticks blur,
                                                                Ticks y) {
    std::vector<const Hindered*> found;
    auto v = std::ranges::upper_bound(lane.hindered, y, {}, &Hindered::key);
    while (v != lane.hindered.begin() && (--v)->key + 2 * blur >= y)
      if (v->key_late >= (y == around.low ? y + 1 : y)) found.push_back(&*v);
    for (const Hindered& past : lane.waiting)
      if (past.due == y) found.push_back(&past);
    return found;
  }

  /// The largest λ(x) + excess(x, y) on a lane. `limit`: S + M, or the latest x.
  std::optional<Ticks> reached(Lane& lane, const Lateness& around, const Lambda& lambda,
                               const Reach& r, Ticks y) {
    while (lane.known < lane.items.size() && lane.items[lane.known].alpha < y) {
      Item& item = lane.items[lane.known++];
      item.before = lambda.at(item.alpha);
    }
    std::optional<Ticks> best;
    // The x of a shared XPU may be another clock's: as late as just before S + M.
    const Ticks limit = lane.shared ? around.change + r.meets_p : last_x_alone(around, r);
    bool at_limit = !lane.shared || limit >= y;
    Ticks sum = 0;  // D(x, y)
    for (const Item& item : lane.past)
      if (item.alpha >= y && item.key <= y) sum += item.work;
    Share share(lane, around, r.blur, y);
    std::optional<BlocksOne> in_the_way;
    if (lane.blocks) {
      const auto whom = hindered_at(lane, around, r.blur, y);
      pairs_ -= static_cast<std::int64_t>(lane.in_the_way.size() * (whom.size() + 1));
      in_the_way.emplace(lane.in_the_way, whom, waits_, lane.lag, y);
    }
    const auto excess = [&](Ticks x, Ticks less) {
      // Jobs of q alone are a pattern of q as they are; α may be 2b after `a`.
      if (lane.shared && lane.kind != Kind::kOfP && x > around.before + r.meets_p)
        return std::min(sum - less, most(2 * r.blur, r.drift.ppm));
      return sum - less;
    };
    // Just after t_lo it counts only for who may have its key there.
    const bool beside = lane.overrun != nullptr && (y != around.low || lane.at_low);
    const Ticks most_beside = beside ? lane.most_beside() : 0;
    const auto look = [&](Ticks x, Ticks before) {
      const Ticks length = least(y - x, r.drift.ppm);
      const Ticks less = lane.shared ? share.at_least(x) : length;
      Ticks found = before + excess(x, less) + most_beside;
      if (in_the_way) found += in_the_way->at(x);
      // What λ does not rise by need not be known exactly.
      if (lane.shared && found > std::max(lambda.largest(), best.value_or(0))) {
        const bool of_both = lane.kind == Kind::kOfBoth;
        found = before + excess(x, of_both ? share.of_both(x, pairs_) : less);
        if (beside) found += lane.beside(length);
      }
      best = std::max(best.value_or(found), found);
    };
    pairs_ -= static_cast<std::int64_t>(lane.known + lane.past.size());
    if (pairs_ < 0) return best;
    for (std::size_t k = lane.known; k-- > 0 && pairs_ >= 0;) {
      const Item& item = lane.items[k];
      if (item.key > y) continue;
      if (item.alpha < limit && !at_limit) {
        if (sum > 0) look(limit, lambda.at(limit - 1));
        at_limit = true;
      }
      sum += item.work;
      if (item.alpha < limit) look(item.alpha, item.before);
    }
    if (!at_limit && sum > 0) look(limit, lambda.at(limit - 1));
    return best;
  }

  /// λ of a set. `reaches`: see `settle`. False: too many pairs.
  bool rise(const std::vector<int>& set, const Lateness& around, const Reach& r, Lambda& lambda,
            __int128& reaches) {
    std::vector<std::pair<Ticks, int>> keys;
    for (const int m : set) {
      Lane& lane = lanes_[at(m)];
      lane.known = 0;
      if (!lane.items.empty()) keys.emplace_back(around.low, m);
      for (const Item& item : lane.items)
        if (item.key > around.low) keys.emplace_back(item.key, m);
      for (const Item& item : lane.past)
        if (item.due > around.low) keys.emplace_back(item.due, m);
    }
    std::ranges::sort(keys);
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    for (const auto& [y, m] : keys) {
      Lane& lane = lanes_[at(m)];
      const auto found = reached(lane, around, lambda, r, y);
      if (pairs_ < 0) return false;
      if (!found) continue;
      if (!lane.shared)
        reaches =
            std::max(reaches, slope_of_ * *found + slope_ * since_release(y - around.before, r));
      if (*found <= lambda.largest()) continue;
      const Ticks from = y == around.low ? y + 1 : y;
      if (!lambda.rises.empty() && lambda.rises.back().first == from)
        lambda.rises.back().second = *found;
      else
        lambda.rises.emplace_back(from, *found);
    }
    return true;
  }

  bool walk(std::size_t k) {
    OfClock& of = of_.clocks[k];
    const Grid& grid = grids_[k];
    const Reach r = reach_of(k);
    lanes_.assign(p_.platform.xpus.size(), {});
    for (std::size_t m = 0; m < lanes_.size(); ++m) {
      if (!users_[m].contains(of.clock)) continue;
      lanes_[m].blocks = blocks(m) && users_[m].size() == 1;
      lanes_[m].lag = r.drift.longest(lags_[m]);
      if (users_[m].size() > 1 && !make_lane(of, r, m)) return too_much();
    }
    const std::size_t sets = of_.sets.size();
    std::vector<__int128>& reaches = reaches_.emplace_back(sets, 0);
    of.largest.assign(sets, 0);
    of.changes.clear();
    const Ticks notice = r.drift.longest(ask_.notice);
    Ticks before = grid.releases.back() - of.hyperperiod;
    for (const Ticks change : grid.releases) {
      Lateness around{change, before, before - notice, {}, std::vector<Lambda>(sets)};
      if (!make_items(of, r, grid, around)) return false;
      for (std::size_t set = 0; set < sets; ++set) {
        Lambda& lambda = around.lambdas[set];
        if (!rise(of_.sets[set], around, r, lambda, reaches[set])) return too_much();
        of.largest[set] = std::max(of.largest[set], lambda.largest());
      }
      of.changes.push_back(std::move(around));
      before = change;
    }
    return true;
  }

  bool make_lane(const OfClock& of, const Reach& r, std::size_t m) {
    Lane& lane = lanes_[m];
    lane.shared = true;
    lane.kind = kind_[m];
    if (blocks(m)) lane.overrun = &overruns_[m];
    return (lane.kind == Kind::kOfQ || make_dbf(of, r, m, false, lane.dbf_p)) &&
           (lane.kind == Kind::kOfP || make_dbf(of, r, m, true, lane.dbf_q));
  }

  bool make_dbf(const OfClock& of, const Reach& r, std::size_t m, bool of_q, Dbf& dbf) {
    const World& w = ask_.both.of(of_q);
    std::vector<Dbf::Span> spans;
    bool fits = true;
    each_xnode(of.clock, [&](const Component& c, int i) {
      if (w.policy.placements[at(i)].xpu != static_cast<int>(m)) return;
      pairs_ -= of.hyperperiod / c.period;
      fits = fits && pairs_ >= 0;
      for (std::int64_t n = 0; fits && n < of.hyperperiod / c.period; ++n) {
        const Ticks release = c.phi + n * c.period;
        const Window& window = w.window(i, n);
        spans.push_back({release + a_of(window), release + window.d, work_with_cost(w, i)});
      }
    });
    const Ticks longest = r.back + r.ahead + of.hyperperiod + r.drift.longest(ask_.notice);
    return fits && dbf.make(std::move(spans), of.hyperperiod, longest, pairs_);
  }

  // ------------------------------------------------------------------------------------- settling

  /// From the release before S to y, in real time, at the rate in which `least` counts from x to y. x
  /// may be M later than that release.
  [[nodiscard]] Ticks since_release(Ticks length, const Reach& r) const {
    const std::int64_t ppm = r.drift.ppm;
    return ceil_div(static_cast<__int128>(length) * (kMillion - ppm), kMillion) +
           most(r.meets_p, ppm) - least(r.meets_p, ppm);
  }

  /// From S + E on lateness is at most Λ - τ (y - S - E). On a shared XPU that follows, with E = M,
  /// from r's slack. On one of a clock alone a job of p may be in the sum with q's work of any length,
  /// and no certificate is of both: so all λ(x) + excess(x, y) have to be below that line, if x is one
  /// of those up to M after the release before S. Later ones are q's, with its slack. The rise of λ
  /// alone does not tell: what stays below Λ does not rise, and may be above the line. Beyond the keys
  /// looked at, it falls from hyperperiod to hyperperiod. So it is for each set: of two, one of which has
  /// all XPUs of the other, it has the higher line.
  void settle() {
    for (std::size_t set = 0; set < of_.sets.size(); ++set) {
      __int128 sum = 0;
      for (const OfClock& of : of_.clocks) sum += of.largest[set];
      __int128 last = meets_p_ * slope_ + sum * slope_of_;
      for (std::size_t k = 0; k < of_.clocks.size(); ++k)
        last = std::max(last, reaches_[k][set] + (sum - of_.clocks[k].largest[set]) * slope_of_);
      if (sum > kMostWork || last / slope_ >= kMostWork) {
        too_much();
        return;
      }
      of_.settles = std::max(of_.settles, ceil_div(last, static_cast<Ticks>(slope_)));
    }
  }

  const Question& ask_;
  const World& p_;
  const World& q_;
  std::int64_t& pairs_;
  Cluster& of_;
  std::vector<std::set<int>> users_;   ///< [xpu] clocks of this cluster
  std::vector<Kind> kind_;             ///< [xpu] of the shares on it
  bool some_block_ = false;            ///< of the XPUs of this cluster
  std::vector<std::set<int>> fed_by_;  ///< [xpu] directly, by those that L is of
  std::vector<Ticks> lags_;            ///< [xpu] L
  std::vector<Overruns> overruns_;     ///< [xpu]
  std::vector<Grid> grids_;            ///< [clock of the cluster]
  std::vector<First> first_;           ///< [xnode] of one S
  Ticks meets_p_ = 0;                  ///< M, in real time
  Ticks beta_ = 0;                     ///< β
  WhoWaits waits_;
  __int128 slope_ = 1, slope_of_ = 100;
  std::vector<std::vector<__int128>> reaches_;  ///< [clock of the cluster][set]
  std::vector<Lane> lanes_;                     ///< [xpu]
};

/// Both tables' WCETs for `percent` of slack, preempting included; nullopt: a window is too short.
std::optional<std::vector<Ticks>> inflated(const World& w, bool coarse, int percent) {
  std::vector<Ticks> wcet;
  for (std::size_t i = 0; i < w.wcet.size(); ++i) {
    const __int128 work = work_with_cost(w, static_cast<int>(i));
    wcet.push_back(ceil_div(work * 100, 100 - percent));
    for (const Window& window : w.windows[i])
      if (window.a + (coarse ? 1 : 0) + wcet.back() > window.d) return std::nullopt;
  }
  return wcet;
}

bool leaves(const World& w, bool coarse, int percent) {
  auto wcet = inflated(w, coarse, percent);
  if (!wcet) return false;
  Platform platform = w.platform;
  for (Xpu& xpu : platform.xpus) xpu.preempt_us = 0;
  World slower{w.app,          platform,      w.policy, w.scale,          w.components,
               w.component_of, w.before,      w.after,  w.module_xnodes,  w.in_flight,
               w.module_of,    w.entry,       w.order,  std::move(*wcet), w.windows,
               w.urgent,       w.hears_urgent};
  if (coarse)
    for (auto& windows : slower.windows)
      for (Window& window : windows) ++window.a;
  for (std::size_t m = 0; m < platform.xpus.size(); ++m)
    if (!prove_load(slower, static_cast<int>(m))) return false;
  return true;
}

Ticks Lambda::at(Ticks instant) const {
  const auto after = std::ranges::upper_bound(rises, instant, {}, &std::pair<Ticks, Ticks>::first);
  return after == rises.begin() ? 0 : std::prev(after)->second;
}

Ticks Cluster::largest_of_others(std::size_t k, std::size_t set) const {
  Ticks sum = 0;
  for (std::size_t other = 0; other < clocks.size(); ++other)
    if (other != k) sum += clocks[other].largest[set];
  return sum;
}

std::vector<std::vector<int>> clusters(const Both& both) {
  const std::size_t clocks = both.p.app.clocks.size();
  std::vector<int> of(clocks);
  std::iota(of.begin(), of.end(), 0);
  std::vector<int> user(both.p.platform.xpus.size(), -1);
  for (const bool of_q : {false, true})
    for (std::size_t i = 0; i < both.p.wcet.size(); ++i) {
      int& other = user[at(both.of(of_q).policy.placements[i].xpu)];
      const int clock = both.p.home(static_cast<int>(i)).clock;
      if (other < 0) other = clock;
      const int joined = of[at(clock)], to = of[at(other)];
      std::ranges::replace(of, joined, to);
    }
  std::vector<std::vector<int>> all(clocks);
  for (std::size_t clock = 0; clock < clocks; ++clock)
    all[at(of[clock])].push_back(static_cast<int>(clock));
  std::erase_if(all, [](const std::vector<int>& cluster) { return cluster.size() < 2; });
  return all;
}

int slack_percent(const Question& ask) {
  for (const int percent : {8, 5, 3, 2, 1})
    if (leaves(ask.both.p, ask.coarse, percent) && leaves(ask.both.q, ask.coarse, percent))
      return percent;
  return 0;
}

void bound_cluster(const Question& ask, int percent, std::int64_t& pairs, Cluster& of) {
  Bound(ask, pairs, of).run(percent);
}

Around::Around(const Both& both, const Cluster& cluster, std::size_t k, const Lateness& lateness)
    : both_(both),
      set_of_(cluster.set_of),
      lateness_(lateness),
      drift_{both.p.app.clocks[at(cluster.clocks[k].clock)].ppm} {
  const OfClock& of = cluster.clocks[k];
  Ticks last = std::max(lateness.change, lateness.low);
  for (std::size_t set = 0; set < cluster.sets.size(); ++set) {
    others_.push_back(cluster.largest_of_others(k, set));
    const auto& rises = lateness.lambdas[set].rises;
    if (!rises.empty()) last = std::max(last, rises.back().first);
  }
  for (const auto& [job, due] : lateness.dues) last = std::max(last, due);
  Ticks step = 0, offset = 0;
  for (const Component& c : both.p.components)
    if (c.clock == of.clock) {
      step = std::max(step, c.period);
      for (const int s : c.sources)
        offset = std::max(offset, both.p.app.sources[at(s)].offset_us * both.p.scale - c.phi);
    }
  last_ = last + of.hyperperiod + step + offset;
}

}  // namespace xauto::solver::steady::checking::shared

// SPDX-License-Identifier: Apache-2.0
// The jobs of one XPU fall into groups. Releases of one group keep their phases: all components of
// one clock, or, where those repeat too late to be enumerated, one component. Between groups any
// phase may occur.
//
//   one group, preemptive   earliest deadline first is simulated until a pattern repeats the one
//                           before: it meets all keys if any schedule does (Dertouzos 1974)
//   an urgent source        its urgent releases are a group beside the one that all its releases are
//                           in. Of each XNode, at most one urgent job has its window in an interval
//                           that does not hold the ordinary window of that job (keys are in order):
//                           the group counts each XNode once
//   otherwise               demand bound: what has its window in an interval of length t, at worst,
//                           and the longest job that may hold the last level when it begins and has a
//                           later key, is at most t
//
// Other apps are groups, too, of which a demand file says all but the names. Nothing of it is derived again, but for
// who pays for a preemption of whom: another app's job may be what is preempted. A reserve makes all work longer, and
// everybody pays.
//
// Levels. An XPU that does not preempt has one, another one as many as it says, or any number. A job that is
// started while others have started and not ended is on the level above theirs. On the last one it is not
// interrupted. Jobs on levels are nested: each has become ready after the one below has begun, and has an earlier
// key. Inside a group this is followed by phases. Of the other groups, whose phases are not known, as many may
// be below as are nested inside them and longer than the window of the job. With urgent releases each XNode
// counts for itself.
//
// Drift. A window is [R(r) + a, R(r) + d], R the real time of a point of the clock's grid, whose
// slope is in [1 - ppm, 1 + ppm]. A schedule on the grid in which a job gets C / (1 - ppm) within
// [r + a / (1 - ppm), r + d / (1 + ppm)] is, seen through any R, one in real time.
#include "solver/keys/check_load.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>
#include <queue>
#include <set>

#include <fmt/format.h>

namespace xauto::solver::keys::checking {
namespace load {

constexpr std::int64_t kMaxJobs = 400'000;      ///< of one group
constexpr std::int64_t kMaxSteps = 60'000'000;  ///< of all demand curves of one XPU
constexpr std::int64_t kMaxPlayed = 20'000'000;

/// One job of the pattern of a group.
struct Item {
  int xnode = -1;
  std::int64_t activation = 0;
  Ticks release = 0;  ///< on the grid of the clock
  Window window;
  Ticks work = 0;  ///< WCET and, where it may preempt, the cost of that
  bool charged = false;
  /// Earliest begin on the last level, after the release; kMaxTicks: it is never there.
  Ticks last = kMaxTicks;
};

struct Span {
  std::size_t first = 0, size = 0;
};

struct Group {
  std::vector<int> xnodes;
  Ticks period = 0;  ///< of the pattern
  std::int64_t ppm = 0;
  int clock = -1;
  std::vector<Item> items;
  Ticks longest = 0;             ///< from the earliest start of a job to its key
  std::map<int, Span> items_of;  ///< [xnode] where its items are, in the order of activations
  /// Urgent releases alone. Which activations they are is open: an item is the shortest of its XNode's
  /// windows, which may begin up to `slip` later.
  bool urgent = false;
  Ticks slip = 0;
  int other = 0;  ///< of another app: 1 + the index of its demand
};

/// What is in an interval: at its end `demand`, between the begins of two windows and two keys.
struct Step {
  Ticks length = 0, demand = 0;
  const Item* last = nullptr;  ///< whose key is its end
  Ticks shift = 0;             ///< of the release of `last`, against that of the first
};

class Load {
 public:
  Load(const World& w, int m, const Beside& beside)
      : w_(w), xpu_(w.platform.xpus[at(m)]), m_(m), beside_(beside) {}

  Result<XpuProof> prove() {
    proof_.xpu = xpu_.id;
    make_groups();
    if (groups_.empty()) {  // who is there has been tested without this app
      proof_.kind = "no job";
      return proof_;
    }
    return prove_groups(true);
  }

  /// The others alone.
  Result<XpuProof> prove_others() {
    proof_.xpu = xpu_.id;
    return prove_groups(false);
  }

  /// What others have to know. Behind a reserve, or beside others, everybody is told the same: who pays among the app's
  /// own jobs. An XNode that may be urgent always pays: then nobody has to know which of its jobs belong together.
  DemandOnXpu demand() {
    make_groups();
    if (costs()) charge();
    DemandOnXpu on;
    on.xpu.id = xpu_.id;
    on.xpu.preemptive = xpu_.preemptive;
    on.xpu.preempt_us = xpu_.preempt_us;
    on.xpu.levels = xpu_.levels;
    for (Group& g : groups_) {
      DemandSequence& s = on.sequences.emplace_back();
      s.period = g.period;
      s.ppm = g.ppm;
      s.once = g.urgent;
      s.slip = g.slip;
      for (Item& i : g.items) {
        if (costs() && !i.charged && !w_.urgent[at(i.xnode)].empty()) pay(i);
        s.jobs.push_back({i.release - floor_div(i.release, g.period) * g.period, i.window.a,
                          i.window.e, i.window.d, i.work, i.charged});
      }
    }
    return on;
  }

 private:
  /// Of what make_groups() has found and of the others; `own`: there is something of the app.
  Result<XpuProof> prove_groups(bool own) {
    XAUTO_TRY(add_others());
    if (costs()) charge();
    find_last();
    for (Group& g : groups_)
      for (Item& i : g.items) i.work = with_reserve(i.work);
    Ticks longest = 0;
    for (const Group& g : groups_) {
      if (g.urgent) continue;
      __int128 sum = 0;
      for (const Item& i : g.items) sum += i.work;
      proof_.load += static_cast<double>(sum) / (static_cast<double>(g.period) * slowdown(g));
      proof_.jobs += static_cast<std::int64_t>(g.items.size());
      longest = std::max(longest, g.period);
      if (sum > least(g.period, g.ppm)) return overload();
    }
    proof_.repeats_us = w_.us(longest);
    if (proof_.load > 1.000001) return overload();
    if (own && groups_.size() == 1 && !blocks_) {
      proof_.kind = "schedule";
      if (const Status shown = exhibit(groups_[0]); !shown) {
        if (groups_[0].ppm == 0) return tl::unexpected<Error>(shown.error());
        // With drift the demand bound loses less: windows need not shrink.
        proof_.kind = "demand bound";
        XAUTO_TRY(bound_demand());
      }
    } else {
      proof_.kind = blocks_ ? "demand bound and blocking" : "demand bound";
      XAUTO_TRY(bound_demand());
    }
    return proof_;
  }

  static double slowdown(const Group& g) {
    return 1 - static_cast<double>(g.ppm) / static_cast<double>(kMillion);
  }
  [[nodiscard]] std::string where() const { return "XPU " + xpu_.id; }
  [[nodiscard]] std::string where(const Item& i) const {
    if (i.xnode < 0)
      return fmt::format("XPU {}, another app's job, key {} us after its release", xpu_.id,
                         w_.us(i.window.d));
    return fmt::format("XPU {}, XNode '{}', activation {}", xpu_.id, w_.name(i.xnode),
                       i.activation);
  }
  [[nodiscard]] tl::unexpected<Error> overload() const {
    return fail(
        ErrorCode::kInfeasible,
        fmt::format("its jobs load it by {:.4f} %, preemptions included", 100 * proof_.load),
        where(), "move XNodes to another XPU");
  }

  // ------------------------------------------------------------------------------------ groups

  void make_groups() {
    std::map<int, std::vector<int>> by_clock, by_component;
    for (std::size_t i = 0; i < w_.wcet.size(); ++i)
      if (w_.policy.placements[i].xpu == m_)
        by_clock[w_.home(static_cast<int>(i)).clock].push_back(static_cast<int>(i));
    for (const auto& [clock, xnodes] : by_clock) {
      if (add_group(xnodes)) continue;
      by_component.clear();
      for (const int i : xnodes) by_component[w_.component_of[at(i)]].push_back(i);
      // A component has at most as many windows as World allows.
      for (const auto& [component, own] : by_component) add_group(own);
    }
    for (std::size_t c = 0; c < w_.components.size(); ++c) add_urgent(w_.components[c]);
  }

  /// Any of its releases, so far apart.
  void add_urgent(const Component& c) {
    Group g;
    g.urgent = true;
    g.period = c.urgent_apart * c.period;
    g.ppm = c.ppm;
    g.clock = c.clock;
    for (const int i : c.xnodes) {
      const auto& all = w_.urgent[at(i)];
      if (all.empty() || w_.policy.placements[at(i)].xpu != m_) continue;
      const auto [first, last] = std::ranges::minmax(all, {}, &Window::a);
      Ticks shortest = kMaxTicks, longest = 0;
      for (const Window& window : all) {
        shortest = std::min(shortest, window.d - window.a);
        longest = std::max(longest, window.d - window.e);
      }
      g.xnodes.push_back(i);
      g.slip = std::max(g.slip, last.a - first.a);
      g.longest = std::max(g.longest, longest);
      const Ticks key = first.a + shortest;
      g.items_of[i] = {g.items.size(), 1};
      g.items.push_back({i, 0, 0, {first.a, key, key - longest}, w_.wcet[at(i)]});
    }
    if (g.items.empty()) return;
    // Jobs of two urgent releases, the older one deeper in its chain, may begin at any distance
    // unless one chain has begun before the next: then, at worst, all begin at once.
    const auto [first, last] =
        std::ranges::minmax(g.items, {}, [](const Item& i) { return i.window.a; });
    if (last.window.a + g.slip - first.window.a > least(g.period, g.ppm)) {
      g.slip = 0;
      for (Item& i : g.items) i.window = {0, i.window.d - i.window.a, i.window.e - i.window.a};
    }
    groups_.push_back(std::move(g));
  }

  [[nodiscard]] bool costs() const { return xpu_.preemptive && xpu_.preempt_us > 0; }

  /// Of all there is, the reserve is for others.
  [[nodiscard]] Ticks with_reserve(Ticks work) const {
    return beside_.reserve_pct == 0
               ? work
               : ceil_div(static_cast<__int128>(work) * 100, 100 - beside_.reserve_pct);
  }

  [[nodiscard]] bool with_others() const {
    return beside_.reserve_pct > 0 ||
           std::ranges::any_of(groups_, [](const Group& g) { return g.other > 0; });
  }

  [[nodiscard]] tl::unexpected<Error> does_not_fit() const {
    return fail(ErrorCode::kInvalid, "times of another app do not fit", where(),
                "state periods as ratios of smaller numbers");
  }

  Status add_others() {
    int items = 0;
    __int128 work = 0;
    for (std::size_t k = 0; k < beside_.demands.size(); ++k) {
      const Demand& demand = beside_.demands[k];
      const Ticks factor = w_.scale / demand.ticks_per_us;
      for (const DemandOnXpu& on : demand.xpus) {
        if (on.xpu.id != xpu_.id) continue;
        for (const DemandSequence& s : on.sequences) {
          Group g;
          g.other = static_cast<int>(k) + 1;
          g.clock = -1 - static_cast<int>(groups_.size());
          g.ppm = s.ppm;
          g.urgent = s.once;
          if (s.period > kMaxTicks / factor) return does_not_fit();
          g.period = s.period * factor;
          g.slip = s.slip * factor;
          for (const DemandJob& j : s.jobs) {
            if (j.key > kMaxTicks / factor || j.work > kMaxTicks / factor ||
                -j.start > kMaxTicks / factor)
              return does_not_fit();
            g.items.push_back({--items, 0, j.release * factor,
                               Window{j.ready * factor, j.key * factor, j.start * factor},
                               j.work * factor, j.charged});
            g.longest = std::max(g.longest, (j.key - j.start) * factor);
            work += g.items.back().work;
            if (work > kMaxTicks) return does_not_fit();
          }
          groups_.push_back(std::move(g));
        }
      }
    }
    return {};
  }

  bool add_group(const std::vector<int>& xnodes) {
    Group g;
    g.xnodes = xnodes;
    g.ppm = w_.home(xnodes[0]).ppm;
    g.clock = w_.home(xnodes[0]).clock;
    g.period = 1;
    bool alone = true;
    for (const int i : xnodes) {
      alone = alone && w_.component_of[at(i)] == w_.component_of[at(xnodes[0])];
      if (g.period > 0) g.period = lcm(g.period, w_.home(i).pattern());
    }
    if (alone) g.period = w_.home(xnodes[0]).pattern();
    if (g.period == 0) return false;
    std::int64_t jobs = 0;
    for (const int i : xnodes) {
      jobs += g.period / w_.home(i).period;
      if (jobs > kMaxJobs && !alone) return false;
    }
    for (const int i : xnodes) {
      const Component& c = w_.home(i);
      g.items_of[i] = {g.items.size(), static_cast<std::size_t>(g.period / c.period)};
      for (std::int64_t n = 0; n < g.period / c.period; ++n)
        g.items.push_back({i, n, c.phi + n * c.period, w_.window(i, n), w_.wcet[at(i)]});
      for (const Window& window : w_.windows[at(i)])
        g.longest = std::max(g.longest, window.d - window.e);
    }
    groups_.push_back(std::move(g));
    return true;
  }

  // ----------------------------------------------------------------------------------- charges

  /// Of XNode j, the last activations that may have started before real time `a` after `release`.
  [[nodiscard]] std::int64_t last_started(int j, Ticks release, Ticks a) const {
    const Component& c = w_.home(j);
    Ticks e = kMaxTicks;
    for (const Window& window : w_.windows[at(j)]) e = std::min(e, window.e);
    const Ticks y = a - e;
    const Ticks reach = y > 0 ? ceil_div(static_cast<__int128>(y) * kMillion, kMillion - c.ppm) : 0;
    return floor_div(static_cast<__int128>(reach) + release - c.phi, c.period);
  }

  /// A job preempts when it becomes ready, at most once, and pays. So it pays if a job of a later
  /// key on this XPU may have started before it is ready.
  void charge() {
    for (Group& g : groups_) {
      std::vector<std::int64_t> lags;
      int lags_of = -1;
      for (Item& i : g.items) {
        if (i.charged) continue;  // a demand file says so
        if (beside_.reserve_pct > 0) {
          pay(i);
          continue;
        }
        if (lags_of != i.xnode) lags.clear();  // items are by XNode; most need none
        lags_of = i.xnode;
        const auto over_other = [&](const Group& other) {
          if (g.other > 0 && g.other == other.other) return false;  // that is in its file
          if (g.other != other.other) return other.longest > i.window.d - i.window.a;
          if (g.urgent || other.urgent) return may_preempt_urgent(i, other);
          return &other != &g && may_preempt(i, g, other);
        };
        if ((!g.urgent &&
             std::ranges::any_of(g.xnodes, [&](int j) { return may_preempt(i, j, lags); })) ||
            std::ranges::any_of(groups_, over_other))
          pay(i);
      }
    }
    // An urgent job takes the place of one that is counted with what it pays.
    for (const Group& urgent : groups_)
      for (const Item& u : urgent.items)
        for (Group& g : groups_)
          for (Item& i : g.items)
            if (urgent.urgent && u.charged && i.xnode == u.xnode && !i.charged) pay(i);
  }

  void pay(Item& i) {
    i.work += xpu_.preempt_us * w_.scale;
    i.charged = true;
    ++proof_.charged;
  }

  /// Whether j is behind i by edges and order. All pairs at once: that is a bit for each, and no walk of the graph.
  bool follows(int i, int j) const {
    if (behind_.empty()) find_behind();
    const std::size_t k = number_[at(j)];
    return (behind_[at(i)][k / 64] >> (k % 64) & 1) != 0;
  }
  void find_behind() const {
    const std::size_t n = w_.app.xnodes.size();
    number_.assign(n, 0);
    std::size_t here = 0;
    for (std::size_t x = 0; x < n; ++x)
      if (w_.policy.placements[x].xpu == m_) number_[x] = here++;
    behind_.assign(n, std::vector<std::uint64_t>(here / 64 + 1));
    for (auto at_x = w_.order.rbegin(); at_x != w_.order.rend(); ++at_x)
      for (const int v : w_.after[at(*at_x)]) {
        std::vector<std::uint64_t>& mine = behind_[at(*at_x)];
        for (std::size_t k = 0; k < mine.size(); ++k) mine[k] |= behind_[at(v)][k];
        if (w_.policy.placements[at(v)].xpu == m_)
          mine[number_[at(v)] / 64] |= std::uint64_t{1} << (number_[at(v)] % 64);
      }
  }

  /// Phases are known.
  bool may_preempt(const Item& i, int j, std::vector<std::int64_t>& lags) const {
    const Component& c = w_.home(j);
    // Of most pairs of one component only the jobs of one release can meet: what is below says the same.
    const Window& one = w_.windows[at(j)].front();
    if (w_.component_of[at(j)] == w_.component_of[at(i.xnode)] && c.ppm == 0 &&
        w_.windows[at(j)].size() == 1 && i.window.a - one.e < c.period &&
        one.d - c.period <= i.window.d)
      return one.d > i.window.d && one.e < i.window.a && one.d - one.e > i.window.d - i.window.a &&
             !follows(i.xnode, j);
    for (std::int64_t n = last_started(j, i.release, i.window.a);; --n) {
      const Window& other = w_.window(j, n);
      const Ticks delta = c.phi + n * c.period - i.release;
      if (most(delta, c.ppm) + other.d <= i.window.d) return false;  // so are all earlier keys
      if (least(delta, c.ppm) + other.e >= i.window.a) continue;
      // It is one distance that drifts: by no length of it has a window that is not longer begun before and ends after.
      if (other.d - other.e <= i.window.d - i.window.a) continue;
      if (w_.part_of[at(j)] == w_.part_of[at(i.xnode)]) {
        // An activation of j waits for the same one of i, or for none before the next.
        if (n == i.activation && follows(i.xnode, j)) continue;
        if (n <= i.activation) return true;
        if (lags.empty()) lags = w_.lags_after(i.xnode);
        const std::int64_t first = i.activation + lags[at(j)];  // waits for i
        if (n >= first) {
          n = first;
          continue;
        }
      }
      return true;
    }
  }

  /// One of them is urgent: any phase may occur, but activations of one XNode are in order.
  static bool may_preempt_urgent(const Item& i, const Group& other) {
    return std::ranges::any_of(other.items, [&](const Item& j) {
      return j.xnode != i.xnode && j.window.d - j.window.e > i.window.d - i.window.a;
    });
  }

  /// Any phase may occur, or, of one clock without drift, any that the periods' divisor allows.
  [[nodiscard]] bool may_preempt(const Item& i, const Group& own, const Group& other) const {
    const auto pairs =
        static_cast<__int128>(own.items.size()) * static_cast<std::int64_t>(other.items.size());
    if (own.clock != other.clock || own.ppm > 0 || pairs > kMaxSteps)
      return other.longest > i.window.d - i.window.a;  // half a tick may lie between
    const Ticks divisor = std::gcd(own.period, other.period);
    return std::ranges::any_of(other.items, [&](const Item& j) {
      const Ticks low = i.window.d - j.window.d, high = i.window.a - j.window.e;
      const Ticks phase = j.release - i.release;
      const Ticks next = phase + (floor_div(low - phase, divisor) + 1) * divisor;
      return next < high;
    });
  }

  // ------------------------------------------------------------------------------------ levels

  /// Of activation n of an XNode of `g`: its begin as asked for.
  static Ticks begin_of(const Group& g, const std::vector<Ticks>& begins, int xnode,
                        std::int64_t n) {
    const Span& of = g.items_of.at(xnode);
    const auto size = static_cast<std::int64_t>(of.size);
    return begins[of.first + static_cast<std::size_t>((n % size + size) % size)];
  }

  /// Sets `last` of all items, and whether some job may wait while all levels are in use. Beside others, who may be
  /// below is not looked at: each may be the last.
  void find_last() {
    std::set<int> here;
    bool urgent = false;
    if (with_others()) {
      blocks_ = !xpu_.preemptive || xpu_.levels > 0;
      for (Group& g : groups_)
        for (Item& i : g.items)
          if (blocks_) i.last = i.window.e;
      return;
    }
    for (const Group& g : groups_) {
      here.insert(g.xnodes.begin(), g.xnodes.end());
      urgent = urgent || g.urgent;
    }
    const auto levels = static_cast<std::size_t>(!xpu_.preemptive ? 1 : xpu_.levels);
    // One activation of an XNode at a time, and one of another XNode that waits.
    if (levels == 0 || here.size() <= levels) return;
    // Where phases are known, how long jobs may be at each depth; else of each XNode one job.
    std::vector<std::vector<std::vector<Ticks>>> inside;  // [group][depth - 1][item] lengths
    std::map<int, Ticks> longest_of;
    for (const Group& g : groups_) {
      inside.push_back(lengths_inside(g, urgent ? 1 : levels + 1));
      for (std::size_t k = 0; k < g.items.size(); ++k) {
        Ticks& longest = longest_of[g.items[k].xnode];
        longest = std::max(longest, inside.back()[0][k]);
      }
    }
    std::vector<std::vector<Ticks>> deepest;  // [group][depth - 1]
    for (const auto& depths : inside) {
      deepest.emplace_back();
      for (const auto& lengths : depths) deepest.back().push_back(std::ranges::max(lengths));
    }
    for (std::size_t g = 0; g < groups_.size(); ++g)
      for (std::size_t k = 0; k < groups_[g].items.size(); ++k) {
        Item& i = groups_[g].items[k];
        const Ticks shortest = i.window.d - i.window.a;
        std::vector<Ticks> below;
        for (std::size_t depth = 1; depth < inside[g].size(); ++depth)
          if (inside[g][depth][k] > 0) below.push_back(inside[g][depth][k]);
        if (urgent) {
          for (const auto& [j, length] : longest_of)
            if (j != i.xnode && length > shortest) below.push_back(length);
        } else {
          for (std::size_t other = 0; other < groups_.size(); ++other)
            for (const Ticks length : deepest[other])
              if (other != g && length > shortest) below.push_back(length);
        }
        blocks_ = blocks_ || below.size() >= levels;
        if (below.size() + 1 < levels) continue;
        std::ranges::sort(below, std::greater<>());
        Ticks length = inside[g][0][k];
        if (levels > 1) length = std::min(length, below[levels - 2]);
        i.last = i.window.d - length;
      }
  }

  /// From the earliest begin above `depth` - 1 jobs of the group to the key; 0: never.
  [[nodiscard]] std::vector<std::vector<Ticks>> lengths_inside(const Group& g,
                                                               std::size_t most) const {
    std::vector<std::vector<Ticks>> all;
    std::vector<Ticks> begins;
    for (const Item& i : g.items) begins.push_back(i.window.e);
    while (true) {
      std::vector<Ticks> lengths;
      for (std::size_t k = 0; k < g.items.size(); ++k)
        lengths.push_back(std::max<Ticks>(0, g.items[k].window.d - begins[k]));
      if (std::ranges::max(lengths) == 0) return all;
      all.push_back(std::move(lengths));
      if (all.size() == std::min(most, g.xnodes.size())) return all;
      std::vector<Ticks> next;
      std::vector<std::int64_t> lags;
      int lags_of = -1;
      for (const Item& i : g.items) {
        if (lags_of != i.xnode) lags.clear();
        lags_of = i.xnode;
        next.push_back(std::max(i.window.e, above_one(i, g, begins, lags)));
      }
      begins = std::move(next);
    }
  }

  /// Earliest begin above a job of the group, which begins as `begins` say: phases are known.
  Ticks above_one(const Item& i, const Group& g, const std::vector<Ticks>& begins,
                  std::vector<std::int64_t>& lags) const {
    Ticks earliest = kMaxTicks;
    for (const int j : g.xnodes) {
      if (j == i.xnode) continue;
      const Component& c = w_.home(j);
      for (std::int64_t n = last_started(j, i.release, i.window.a);; --n) {
        const Ticks delta = c.phi + n * c.period - i.release, d = w_.window(j, n).d;
        if (most(delta, c.ppm) + d <= i.window.d) break;
        const Ticks begun = begin_of(g, begins, j, n);
        if (begun == kMaxTicks || least(delta, c.ppm) + begun >= i.window.a ||
            d - begun <= i.window.d - i.window.a)
          continue;
        if (w_.part_of[at(j)] == w_.part_of[at(i.xnode)]) {
          if (lags.empty()) lags = w_.lags_after(i.xnode);
          if (n >= i.activation + lags[at(j)]) {
            n = i.activation + lags[at(j)];
            continue;
          }
        }
        // It is one distance: long enough for the key to be later.
        earliest = std::min(earliest, std::max(least(delta, c.ppm), i.window.d - d) + begun);
      }
    }
    return earliest;
  }

  // ---------------------------------------------------------------------------------- schedule

  struct Pending {
    Ticks key = 0;
    std::size_t item = 0;
    Ticks left = 0;
    bool operator>(const Pending& o) const { return key != o.key ? key > o.key : item > o.item; }
    bool operator==(const Pending&) const = default;
  };
  struct Occurrence {
    Ticks ready = 0, key = 0, work = 0;
    const Item* item = nullptr;
  };

  /// The pattern on the grid, each window begun in [0, period).
  [[nodiscard]] std::vector<Occurrence> occurrences(const Group& g) const {
    std::vector<Occurrence> all;
    all.reserve(g.items.size());
    for (const Item& i : g.items) {
      Occurrence s{
          i.release + ceil_div(static_cast<__int128>(i.window.a) * kMillion, kMillion - g.ppm),
          i.release + floor_div(static_cast<__int128>(i.window.d) * kMillion, kMillion + g.ppm),
          ceil_div(static_cast<__int128>(i.work) * kMillion, kMillion - g.ppm), &i};
      const Ticks shift = floor_div(s.ready, g.period) * g.period;
      s.ready -= shift;
      s.key -= shift;
      all.push_back(s);
    }
    std::ranges::sort(all, {}, &Occurrence::ready);
    return all;
  }

  Status exhibit(const Group& g) {
    const std::vector<Occurrence> all = occurrences(g);
    std::priority_queue<Pending, std::vector<Pending>, std::greater<>> queue;
    Ticks now = 0, worst = kMaxTicks;
    std::size_t tight = 0;
    const auto run_until = [&](Ticks end) -> bool {
      while (!queue.empty() && now < end) {
        Pending p = queue.top();
        const Ticks ran = std::min(p.left, end - now);
        now += ran;
        p.left -= ran;
        queue.pop();
        if (p.left > 0) {
          queue.push(p);
          continue;
        }
        if (p.key - now < worst) {
          worst = p.key - now;
          tight = p.item;
        }
        if (now > p.key) return false;
      }
      now = std::max(now, end);
      return true;
    };
    std::vector<Pending> before;
    for (std::int64_t played = 0;;) {
      for (std::size_t k = 0; k < all.size(); ++k) {
        const bool met = run_until(all[k].ready);
        if (!met) return misses(all, tight, g);
        queue.push({all[k].key, k, all[k].work});
      }
      if (!run_until(g.period)) return misses(all, tight, g);
      std::vector<Pending> state;
      for (auto copy = queue; !copy.empty(); copy.pop()) {
        state.push_back(copy.top());
        state.back().key -= g.period;
      }
      now = 0;
      queue = {};
      for (const Pending& p : state) queue.push(p);
      // With less work than time, the backlog settles: in the next round it is no longer.
      if (state == before) break;
      before = std::move(state);
      played += static_cast<std::int64_t>(all.size());
      if (played > kMaxPlayed)
        return fail(ErrorCode::kInfeasible, "no schedule that repeats was found", where(),
                    "its load is too close to 100 %");
    }
    return tightest(all, tight, g, worst);
  }

  /// The interval that ends with the key of `tight` and has the least slack.
  [[nodiscard]] Step interval(const std::vector<Occurrence>& all, std::size_t tight,
                              const Group& g) const {
    const Ticks end = all[tight].key;
    Ticks demand = 0, longest = 0;
    for (const Occurrence& s : all) longest = std::max(longest, s.key - s.ready);
    Step best{kMaxTicks, 0, all[tight].item};
    const Ticks first = floor_div(end, g.period) * g.period;
    // Further back each pattern adds as much length, and no more work, than the one after it.
    for (Ticks base = first; base > first - longest - 2 * g.period; base -= g.period)
      for (std::size_t k = all.size(); k-- > 0;) {
        const Ticks ready = all[k].ready + base;
        if (all[k].key + base <= end) {
          demand += all[k].work;
          if (end - ready - demand < best.length - best.demand)
            best = {end - ready, demand, all[tight].item};
        }
      }
    return best;
  }

  Status misses(const std::vector<Occurrence>& all, std::size_t tight, const Group& g) const {
    const Step s = interval(all, tight, g);
    const Item& i = *s.last;
    return fail(
        ErrorCode::kInfeasible,
        fmt::format("{} us of work, charged preemptions included, have their windows in the {} us "
                    "before its key, {} us after its release",
                    w_.us(s.demand), w_.us(s.length), w_.us(i.window.d)),
        where(i), "give it, or what runs beside it, a later key");
  }

  Status tightest(const std::vector<Occurrence>& all, std::size_t tight, const Group& g,
                  Ticks slack) {
    const Step s = interval(all, tight, g);
    // The schedule and the demand are counted in two ways.
    if (s.length - s.demand != slack)
      return fail(ErrorCode::kInternal,
                  fmt::format("the schedule leaves {} us, the demand {} us", w_.us(slack),
                              w_.us(s.length - s.demand)),
                  where(*s.last), "this is a bug of the check; please report it");
    note(s, 0);
    return {};
  }

  void note(const Step& s, Ticks blocked) {
    proof_.xnode = s.last->xnode < 0 ? "another app's job" : w_.name(s.last->xnode);
    proof_.activation = s.last->activation;
    proof_.length_us = w_.us(s.length);
    proof_.demand_us = w_.us(s.demand + blocked);
    proof_.slack_us = w_.us(s.length - s.demand - blocked);
  }

  // ------------------------------------------------------------------------------ demand bound

  /// On a level above others a job has paid for it.
  [[nodiscard]] Ticks to_start_above() const {
    return xpu_.preemptive ? xpu_.preempt_us * w_.scale : 0;
  }

  struct Blocker {
    Ticks until = 0;  ///< what it blocks are intervals shorter than this
    Ticks work = 0;
    int xnode = -1;
  };

  /// What arrives once a period.
  struct Stream {
    Ticks period, spread, work;
  };

  enum class StreamOf {
    kXNode,  ///< its longest job, once a period
    kJob,  ///< once a turn of its group: less work where not every job of an XNode pays for a preemption
  };

  /// Longest interval that jobs, and one that blocks, can keep busy; nothing if no end was found.
  [[nodiscard]] std::optional<Ticks> busy(Ticks blocked, StreamOf of) const {
    std::vector<Stream> all;
    Ticks once = 0;
    for (const Group& g : groups_) {
      if (g.urgent)
        for (const Item& i : g.items) once += i.work;
      else if (g.other > 0 || of == StreamOf::kJob)
        for (const Item& i : g.items) all.push_back({least(g.period, g.ppm), 0, i.work});
      else
        add_xnodes(g, all);
    }
    return busy(all, blocked + once);
  }

  void add_xnodes(const Group& g, std::vector<Stream>& all) const {
    std::map<int, Stream> of;
    for (const Item& i : g.items) {
      Stream& load = of.try_emplace(i.xnode, Stream{least(w_.home(i.xnode).period, g.ppm), 0, 0})
                         .first->second;
      load.work = std::max(load.work, i.work);
    }
    for (auto& [i, load] : of) {
      const auto [low, high] = std::ranges::minmax(w_.windows[at(i)], {}, &Window::a);
      load.spread = high.a - low.a;
      all.push_back(load);
    }
  }

  static std::optional<Ticks> busy(const std::vector<Stream>& all, Ticks at_first) {
    __int128 length = at_first;
    for (const Stream& load : all) length += load.work;
    for (std::int64_t steps = 0; steps < kMaxPlayed && length <= kMaxTicks;
         steps += static_cast<std::int64_t>(all.size())) {
      __int128 next = at_first;
      for (const Stream& load : all)
        next += (length + load.spread + load.period - 1) / load.period * load.work;
      if (next <= length) return static_cast<Ticks>(length);
      length = next;
    }
    return {};
  }

  /// Of one clock that does not drift: intervals longer than a turn and a window need not be looked
  /// at, whatever the load. What has its key more than the longest window after an interval's begin
  /// has begun in it; so an interval longer by a turn has more work by exactly the turn's, which is
  /// at most the turn, as `overload` has seen. A blocker matters in shorter ones only.
  [[nodiscard]] std::optional<Ticks> turn() const {
    const Group& g = groups_.front();
    if (groups_.size() > 1 || g.ppm > 0 || g.urgent) return {};
    return g.period + g.longest;
  }

  /// A window's begin on the grid, in [0, period).
  struct Begin {
    Ticks at = 0;
    Ticks shift = 0;  ///< what was taken from the item's release
    const Item* item = nullptr;
  };
  static std::vector<Begin> begins(const Group& g) {
    std::vector<Begin> all;
    for (const Item& i : g.items) {
      const Ticks begin = i.release + i.window.a;
      const Ticks shift = floor_div(begin, g.period) * g.period;
      all.push_back({begin - shift, shift, &i});
    }
    std::ranges::sort(all, {}, &Begin::at);
    return all;
  }

  /// Drift moves the begins of windows, one against another, by less than that.
  static Ticks drift(const Group& g, Ticks end) {
    return g.ppm == 0 ? 0 : 4 * (most(g.longest + end, g.ppm) - g.longest - end) + 2;
  }

  /// Keys of the windows of `g` that begin when that of `all[from]` begins, or later; up to `end`.
  void demand_from(const Group& g, const std::vector<Begin>& all, std::size_t from, Ticks end,
                   std::vector<Step>& steps) const {
    steps.clear();
    const Begin& start = all[from];
    const Ticks release = start.item->release - start.shift;
    const Ticks margin = drift(g, end + g.slip);
    const auto visit = [&](const Begin& b, Ticks base) {
      const Ticks shift = b.item->release - b.shift + base - release;
      const Ticks gap = b.item->window.a - start.item->window.a;
      if (most(shift, g.ppm) + gap < 0) return;
      const Ticks key =
          std::max<Ticks>(0, least(shift, g.ppm) + gap) + b.item->window.d - b.item->window.a;
      if (key <= end + g.slip) steps.push_back({key, b.item->work, b.item, shift});
    };
    Ticks base = 0;
    for (std::size_t k = from;;) {
      if (all[k].at + base - start.at > end + g.slip + margin) break;
      visit(all[k], base);
      if (++k == all.size()) {
        k = 0;
        base += g.period;
      }
    }
    base = 0;
    for (std::size_t k = from;;) {
      if (k == 0) {
        k = all.size();
        base -= g.period;
      }
      --k;
      if (start.at - (all[k].at + base) > margin) break;
      visit(all[k], base);
    }
    std::ranges::sort(steps, {}, &Step::length);
    if (g.urgent) {  // of each XNode the first
      std::set<int> there;
      std::erase_if(steps, [&](const Step& s) { return !there.insert(s.last->xnode).second; });
    }
    Ticks sum = 0, window = 0;
    for (Step& s : steps) {
      s.demand = sum += s.demand;
      window = std::max(window, s.last->window.d - s.last->window.a);
      s.length = std::max(s.length - g.slip, window);
    }
  }

  /// At each length the larger of both curves; only steps that rise.
  static std::vector<Step> larger(const std::vector<Step>& a, const std::vector<Step>& b) {
    std::vector<Step> out;
    std::size_t i = 0, j = 0;
    Ticks top = 0;
    while (i < a.size() || j < b.size()) {
      const bool first = j == b.size() || (i < a.size() && a[i].length <= b[j].length);
      const Step& s = first ? a[i++] : b[j++];
      if (s.demand <= top) continue;
      top = s.demand;
      if (!out.empty() && out.back().length == s.length)
        out.back() = s;
      else
        out.push_back(s);
    }
    return out;
  }

  [[nodiscard]] std::string blocked_by(const Blocker* b) const {
    return b == nullptr
               ? ""
               : fmt::format(", and {} us of {}, which may run when they begin,", w_.us(b->work),
                             b->xnode < 0 ? "another app" : "'" + w_.name(b->xnode) + "'");
  }

  /// Demand and blocking against length, at each step of the curve.
  Status compare(const std::vector<Step>& curve, const Blocker* blocker) {
    for (const Step& s : curve) {
      if (blocker != nullptr && blocker->until <= s.length) break;  // there is as without it
      const Ticks blocked = blocker == nullptr ? 0 : blocker->work;
      const Ticks slack = s.length - s.demand - blocked;
      if (slack < 0)
        return fail(
            ErrorCode::kInfeasible,
            fmt::format("{} us of work{} may have their windows in the {} us before its key{}",
                        w_.us(s.demand), blocked_by(blocker), w_.us(s.length),
                        with_others()
                            ? fmt::format(": {} us too much{}", w_.us(-slack), of_reserve())
                            : ""),
            where(*s.last), "give it, or what runs beside it, a later key");
      if (slack < slack_) {
        slack_ = slack;
        note(s, blocked);
      }
    }
    return {};
  }

  [[nodiscard]] std::string of_reserve() const {
    return beside_.reserve_pct == 0 ? ""
                                    : fmt::format(", with {} % for others", beside_.reserve_pct);
  }

  /// By XNode; of other apps by job, none that blocks for no longer, and no less, than another one.
  [[nodiscard]] std::vector<Blocker> blockers(const Group& g) const {
    std::vector<Blocker> all;
    for (const int j : g.xnodes) {
      Blocker blocker{0, with_reserve(w_.wcet[at(j)] + to_start_above()), j};
      const Span& of = g.items_of.at(j);
      for (std::size_t n = of.first; n < of.first + of.size; ++n)
        blocker.until = std::max(blocker.until, g.items[n].window.d - g.items[n].last);
      all.push_back(blocker);
    }
    if (g.other == 0) return all;
    for (const Item& i : g.items)
      all.push_back({i.window.d - i.last,
                     i.charged ? i.work : i.work + with_reserve(to_start_above()), i.xnode});
    std::ranges::sort(all, [](const Blocker& a, const Blocker& b) {
      return a.until != b.until ? a.until > b.until : a.work > b.work;
    });
    Ticks longest = 0;
    std::erase_if(all, [&](const Blocker& b) {
      const bool less = b.work <= longest;
      longest = std::max(longest, b.work);
      return less;
    });
    return all;
  }

  Status bound_demand() {
    Ticks longest = 0;
    if (blocks_)
      for (const Group& g : groups_)
        for (const Blocker& b : blockers(g)) longest = std::max(longest, b.work);
    std::optional<Ticks> end = busy(longest, StreamOf::kXNode);
    if (!end) end = turn();
    if (!end) end = busy(longest, StreamOf::kJob);
    if (!end) return no_end();

    std::vector<std::vector<Step>> curves;
    for (const Group& g : groups_) {
      std::vector<Step> curve, steps;
      XAUTO_TRY(affordable(g, *end + g.slip));
      const std::vector<Begin> all = begins(g);
      for (std::size_t from = 0; from < all.size(); ++from) {
        demand_from(g, all, from, *end, steps);
        curve = larger(curve, steps);
      }
      curves.push_back(std::move(curve));
    }
    const std::vector<Step> total = sum(curves);
    XAUTO_TRY(compare(total, nullptr));
    for (std::size_t k = 0; blocks_ && k < groups_.size(); ++k)
      for (const Blocker& blocker : blockers(groups_[k])) {
        const int j = blocker.xnode;
        if (groups_[k].urgent || groups_[k].other > 0) {
          steps_ += static_cast<std::int64_t>(total.size());
          if (steps_ > kMaxSteps) return too_many_steps();
          XAUTO_TRY(compare(total, &blocker));
          continue;
        }
        // Most hold whatever is in the interval. Else phases, and who waits for whom, decide.
        const XpuProof proof = proof_;
        const Ticks slack = slack_;
        if (compare(total, &blocker)) continue;
        proof_ = proof;
        slack_ = slack;
        XAUTO_TRY(affordable(groups_[k], *end));
        std::vector<std::vector<Step>> blocked = curves;
        blocked[k] = demand_behind(groups_[k], j, *end);
        XAUTO_TRY(compare(sum(blocked), &blocker));
      }
    return {};
  }

  /// Demand of a group while a job of its XNode j blocks: that started before, and has a later key.
  /// What it has waited for had ended when it started, and is not in the interval.
  [[nodiscard]] std::vector<Step> demand_behind(const Group& g, int j, Ticks end) const {
    const Component& c = w_.home(j);
    const std::vector<std::int64_t> lags = w_.lags_before(j);
    const auto waits = [&](Ticks delta, int i) {
      return lags[at(i)] < kNever && floor_div(delta, c.period) >= lags[at(i)];
    };
    std::vector<Step> curve, steps, own;
    const std::vector<Begin> all = begins(g);
    std::vector<Ticks> last;
    for (const Item& i : g.items) last.push_back(i.last);
    for (std::size_t from = 0; from < all.size(); ++from) {
      const Item& start = *all[from].item;
      const Ticks release = start.release;
      bool known = false;
      for (std::int64_t n = last_started(j, release, start.window.a);; --n) {
        const Window& other = w_.window(j, n);
        const Ticks delta = c.phi + n * c.period - release;
        const Ticks until = most(delta, c.ppm) + other.d - start.window.a;
        if (until <= 0) break;
        const Ticks begun = begin_of(g, last, j, n);
        if (begun == kMaxTicks || least(delta, c.ppm) + begun >= start.window.a ||
            waits(delta, start.xnode))
          continue;
        if (!known) demand_from(g, all, from, end, steps);
        known = true;
        own.clear();
        Ticks sum = 0, before = 0;
        for (const Step& s : steps) {
          const Ticks work = s.demand - before;
          before = s.demand;
          if (s.length >= until) break;
          if (waits(delta - s.shift, s.last->xnode)) continue;
          sum += work;
          own.push_back({s.length, sum, s.last, s.shift});
        }
        curve = larger(curve, own);
      }
    }
    return curve;
  }

  [[nodiscard]] tl::unexpected<Error> no_end() const {
    return fail(
        ErrorCode::kInfeasible,
        fmt::format("at a load of {:.4f} % no end of its busy time was found", 100 * proof_.load),
        where(), "move XNodes to another XPU");
  }

  Status affordable(const Group& g, Ticks end) {
    const auto items = static_cast<__int128>(g.items.size());
    steps_ += items * (items * (end + 2 * drift(g, end)) / g.period + 1);
    if (steps_ > kMaxSteps) return too_many_steps();
    return {};
  }

  [[nodiscard]] tl::unexpected<Error> too_many_steps() const {
    return fail(ErrorCode::kInfeasible,
                fmt::format("its demand has more than {} steps; there is no proof", kMaxSteps),
                where(), "use fewer keys per XNode, or leave it to XNodes of one clock");
  }

  static std::vector<Step> sum(const std::vector<std::vector<Step>>& curves) {
    std::vector<Step> out;
    std::vector<std::size_t> next(curves.size(), 0);
    Ticks total = 0;
    while (true) {
      const Step* first = nullptr;
      std::size_t of = 0;
      for (std::size_t c = 0; c < curves.size(); ++c)
        if (next[c] < curves[c].size() &&
            (first == nullptr || curves[c][next[c]].length < first->length)) {
          first = &curves[c][next[c]];
          of = c;
        }
      if (first == nullptr) return out;
      total += first->demand - (next[of] > 0 ? curves[of][next[of] - 1].demand : 0);
      ++next[of];
      if (!out.empty() && out.back().length == first->length) out.pop_back();
      out.push_back({first->length, total, first->last});
    }
  }

  const World& w_;
  const Xpu& xpu_;
  int m_;
  const Beside& beside_;
  std::vector<Group> groups_;
  XpuProof proof_;
  mutable std::vector<std::vector<std::uint64_t>>
      behind_;                               ///< [xnode] bits by number_; empty: not asked for
  mutable std::vector<std::size_t> number_;  ///< [xnode] of those on this XPU
  bool blocks_ = false;  ///< some job may be on the last level while another one waits
  Ticks slack_ = kMaxTicks;
  __int128 steps_ = 0;
};

}  // namespace load

Result<XpuProof> prove_load(const World& w, int m, const Beside& beside) {
  return load::Load(w, m, beside).prove();
}

Result<XpuProof> prove_together(const Xpu& xpu, std::int64_t ticks_per_us, const Beside& all) {
  const AppSpec nobody;
  const Policy nothing;
  const Platform platform{"the machine", {xpu}};
  World w{nobody, platform, nothing};
  w.scale = ticks_per_us;
  return load::Load(w, 0, all).prove_others();
}

DemandOnXpu demand_on(const World& w, int m) {
  return load::Load(w, m, {}).demand();
}

}  // namespace xauto::solver::keys::checking

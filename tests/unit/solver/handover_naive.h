// SPDX-License-Identifier: Apache-2.0
// Plays a change of tables straight from the text of docs/keys.md (theorem 8), event by
// event over all jobs, and measures what chains and jobs take. Shares nothing with solver/keys.
//
// Times are integers of 1 / scale() us ("ticks"). Each clock begins at an instant of its own, and runs
// faster or slower than it says by at most its ppm: by one rate up to a bend, and by another one after it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/random.h"

namespace xauto::solver::keys {

/// One app under three sets of WCETs, and its two tables.
struct NaiveTables {
  const AppSpec& app_from;  ///< p's envelope
  const AppSpec& app_to;    ///< q's
  const AppSpec& app_both;  ///< the larger of both
  const Platform& platform;
  const Policy& from;  ///< p
  const Policy& to;    ///< q
};

/// All that one play is free in. A byte says how much of what is allowed: 255 all, 0 (nearly) none.
/// What a vector is too short for: all of its work, no jitter.
struct HandoverChoice {
  std::int64_t change = 0;          ///< S, in ticks
  std::int64_t grows = 0;           ///< t: from then on jobs of p may be longer than p's envelope
  std::vector<std::int64_t> begin;  ///< [clock] in ticks; empty: 0
  struct Drift {
    int before = 0, after = 0;  ///< 1: as slow as it may be, -1: as fast, 0: right
    std::int64_t bend = 0;      ///< in ticks of the clock
  };
  std::vector<Drift> drift;                       ///< [clock]; empty: none
  std::vector<std::vector<std::uint8_t>> work;    ///< [xnode][n] of the WCET of its own table
  std::vector<std::vector<std::uint8_t>> grown;   ///< [xnode][n] of what app_both has more
  std::vector<std::vector<std::uint8_t>> jitter;  ///< [source][n]
  bool last_first =
      false;            ///< of two XNodes with equal keys the one of the larger index goes first
  bool drains = false;  ///< another rule than theorem 8's: q's jobs wait until all of p has ended
};

/// How a play is disturbed that nobody has thought about.
struct HandoverDisturbance {
  enum class Times : std::uint8_t { kWorst, kRandom, kNearlyNothing };  ///< the last: of some jobs
  enum class Jitter : std::uint8_t { kZero, kRandom, kLargest };
  std::uint64_t seed = 1;
  Times times = Times::kWorst;
  Jitter jitter = Jitter::kZero;
};

/// What all plays of the same tables have in common.
class HandoverWorld {
 public:
  using Time = std::int64_t;
  using Way = std::vector<std::pair<int, int>>;  ///< samples (u, v), one after the other

  explicit HandoverWorld(const NaiveTables& of) : tables(of), app(of.app_both) {
    for (const SourceSpec& s : app.sources) scale = std::lcm(scale, s.period.den);
    scale *= 8;  // so that changes fall between microseconds
    // And rates are exact: an instant of a clock is a multiple of `exact`.
    for (const ClockSpec& c : app.clocks)
      if (c.ppm > 0) exact = std::lcm(exact, kMillion / std::gcd(kMillion, Time{c.ppm}));
    scale *= exact;
    const std::size_t count = app.xnodes.size();
    component.resize(count);
    std::iota(component.begin(), component.end(), 0);
    for (std::size_t round = 0; round < count; ++round)
      for (const auto& [u, v] : app.edges)
        component[at(u)] = component[at(v)] = std::min(component[at(u)], component[at(v)]);
    first_source.assign(count, -1);
    for (std::size_t i = 0; i < count; ++i)
      for (const int s : app.xnodes[i].sources) {
        int& first = first_source[at(component[i])];
        if (first < 0 || app.sources[at(s)].offset_us < app.sources[at(first)].offset_us) first = s;
      }
    for (std::size_t i = 0; i < count; ++i) first_source[i] = first_source[at(component[i])];
    for (const SourceSpec& s : app.sources)
      hyperperiod = std::lcm(hyperperiod, s.period.num * (scale / s.period.den));
    edges_into();
    modules();
    for (const ChainSpec& c : app.chains) ways_of.push_back(all_ways(c));
  }

  static std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }
  /// Nominal release k of a source.
  [[nodiscard]] Time release(const HandoverChoice& choice, int source, std::int64_t k) const {
    const SourceSpec& s = app.sources[at(source)];
    const Time nominal = s.offset_us * scale + k * s.period.num * (scale / s.period.den);
    const Time begin = choice.begin.empty() ? 0 : choice.begin[at(s.clock)];
    if (choice.drift.empty()) return begin + nominal;
    const HandoverChoice::Drift& drift = choice.drift[at(s.clock)];
    const auto longer = [&](Time length, int rate) {
      return rate * (length / exact * (exact * app.clocks[at(s.clock)].ppm / kMillion));
    };
    const Time bend = drift.bend / exact * exact, until = std::min(nominal, bend);
    return begin + nominal + longer(until, drift.before) + longer(nominal - until, drift.after);
  }
  [[nodiscard]] const Policy& policy(int table) const {
    return table == 0 ? tables.from : tables.to;
  }
  [[nodiscard]] Time wcet(const AppSpec& of, int xnode, int xpu) const {
    return *of.xnodes[at(xnode)].wcet_on(tables.platform.xpus[at(xpu)].type) * scale;
  }
  /// Largest key after a release, in ticks.
  [[nodiscard]] Time deepest() const {
    Time most = 0;
    for (const Policy* p : {&tables.from, &tables.to})
      for (const Placement& x : p->placements)
        for (const Time key : x.key_us) most = std::max(most, key * scale);
    return most;
  }

  struct Before {
    int xnode = 0;
    Time passes[2] = {0, 0};  ///< transfer, by table
  };
  NaiveTables tables;
  const AppSpec& app;  ///< for everything but WCETs
  static constexpr Time kMillion = 1'000'000;
  Time scale = 1, exact = 1;
  Time hyperperiod = 1;                        ///< of all clocks together
  std::vector<int> component, first_source;    ///< [xnode]
  std::vector<std::vector<Before>> before;     ///< [xnode] by edges
  std::vector<std::vector<int>> leaves_first;  ///< [xnode] entries: all XNodes of the module
  std::vector<int> in_flight;                  ///< [xnode]
  std::vector<std::vector<Way>> ways_of;       ///< [chain]

 private:
  void edges_into() {
    before.resize(app.xnodes.size());
    for (std::size_t e = 0; e < app.edges.size(); ++e) {
      const auto [u, v] = app.edges[e];
      Before b;
      b.xnode = u;
      for (const int table : {0, 1}) {
        const auto type = [&](int x) {
          return tables.platform.xpus[at(policy(table).placements[at(x)].xpu)].type;
        };
        for (const TransferSpec& tr : app.transfers)
          if (at(tr.edge) == e && tr.from_type == type(u) && tr.to_type == type(v))
            b.passes[table] = tr.transfer_us * scale;
      }
      before[at(v)].push_back(b);
    }
  }
  void modules() {
    in_flight.assign(app.xnodes.size(), 1);
    leaves_first.resize(app.xnodes.size());
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      const std::string& module = app.xnodes[i].module;
      for (const ModuleSpec& m : app.modules)
        if (m.name == module) in_flight[i] = static_cast<int>(m.max_in_flight);
      const bool entry = std::none_of(before[i].begin(), before[i].end(), [&](const Before& b) {
        return app.xnodes[at(b.xnode)].module == module;
      });
      for (std::size_t k = 0; entry && k < app.xnodes.size(); ++k)
        if (app.xnodes[k].module == module) leaves_first[i].push_back(static_cast<int>(k));
    }
  }
  [[nodiscard]] bool leads(int a, int b) const {
    if (a == b) return true;
    return std::any_of(app.edges.begin(), app.edges.end(),
                       [&](const auto& e) { return e.first == a && leads(e.second, b); });
  }
  void extend(int v, int to, Way& way, std::vector<char>& seen, std::vector<Way>& out) const {
    if (leads(v, to)) out.push_back(way);
    for (const auto& [u, w] : app.samples) {
      if (!leads(v, u) || seen[at(component[at(w)])] != 0) continue;
      seen[at(component[at(w)])] = 1;
      way.emplace_back(u, w);
      extend(w, to, way, seen, out);
      way.pop_back();
      seen[at(component[at(w)])] = 0;
    }
  }
  [[nodiscard]] std::vector<Way> all_ways(const ChainSpec& spec) const {
    std::vector<Way> all;
    for (std::size_t r = 0; r < app.xnodes.size(); ++r) {
      const auto& heard = app.xnodes[r].sources;
      if (std::find(heard.begin(), heard.end(), spec.from) == heard.end()) continue;
      Way way;
      std::vector<char> seen(app.xnodes.size(), 0);
      seen[at(component[r])] = 1;
      extend(static_cast<int>(r), spec.to, way, seen, all);
    }
    return all;
  }
};

/// One play: p from the beginning on, then q.
class HandoverRun {
 public:
  using Time = std::int64_t;

  struct Job {
    int xnode = 0, n = 0, table = 0, xpu = 0;
    Time release = 0, key = 0, hold = 0, arrival = 0;  ///< key and hold after the release
    Time work = 0, more = 0;  ///< `more`: what it takes beyond, if it has not ended at t
    Time left = 0, start = -1, end = -1;
    [[nodiscard]] Time lateness() const { return end - release - key; }
  };

  /// Of all releases before `until` (ticks). What is not released makes nothing later.
  HandoverRun(const HandoverWorld& world, Time until, HandoverChoice choice)
      : w_(world), choice_(std::move(choice)) {
    make_jobs(until);
    play();
  }

  [[nodiscard]] const Job& job(int xnode, int n) const { return jobs_[at(xnode)][at(n)]; }
  [[nodiscard]] int jobs_of(int xnode) const { return static_cast<int>(jobs_[at(xnode)].size()); }
  [[nodiscard]] std::int64_t completed() const {
    std::int64_t sum = 0;
    for (const auto& of : jobs_)
      sum += std::count_if(of.begin(), of.end(), [](const Job& j) { return j.end >= 0; });
    return sum;
  }
  /// Whether all that was released has ended. If not, the rule has a deadlock.
  [[nodiscard]] bool all_ended() const {
    return std::all_of(jobs_.begin(), jobs_.end(),
                       [](const std::vector<Job>& of) { return of.empty() || of.back().end >= 0; });
  }
  /// By the job that ends latest after its key, or least before it, of both tables.
  [[nodiscard]] Time latest() const { return std::max(latest_of(0), latest_of(1)); }
  [[nodiscard]] Time latest_of(int table) const {
    Time most = std::numeric_limits<Time>::min();
    for (const auto& of : jobs_)
      for (const Job& j : of)
        if (j.table == table && j.end >= 0) most = std::max(most, j.lateness());
    return most;
  }
  /// From S to the end of the last job that ends after its key; 0: none does.
  [[nodiscard]] Time settles() const {
    Time last = 0;
    for (const auto& of : jobs_)
      for (const Job& j : of)
        if (j.end >= 0 && j.work > 0 && j.lateness() > 0)
          last = std::max(last, j.end - choice_.change);
    return last;
  }
  /// From S to the end of p's last job.
  [[nodiscard]] Time drained() const {
    Time last = 0;
    for (const auto& of : jobs_)
      for (const Job& j : of)
        if (j.table == 0 && j.end >= 0) last = std::max(last, j.end - choice_.change);
    return last;
  }
  /// When a job first had its XPU for longer than p's envelope (and the preemption it paid) allows,
  /// or -1. The choice of t was within the rules iff this is not before t.
  [[nodiscard]] Time passed() const { return passed_; }

  /// Largest reduced reaction time, in ticks: from a release of the chain's source to the end of
  /// the first job of its last XNode that knows it or a newer one.
  [[nodiscard]] Time seen(std::size_t chain) const {
    Time worst = 0;
    for (const HandoverWorld::Way& way : w_.ways_of[chain])
      worst = std::max(worst, along(w_.app.chains[chain], way));
    return worst;
  }
  [[nodiscard]] double seen_us(std::size_t chain) const {
    return static_cast<double>(seen(chain)) / static_cast<double>(w_.scale);
  }

 private:
  static std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }
  static Time entry(const std::vector<std::vector<std::uint8_t>>& of, std::size_t i, int n,
                    Time otherwise) {
    return i < of.size() && at(n) < of[i].size() ? of[i][at(n)] : otherwise;
  }

  [[nodiscard]] Time nominal(int source, std::int64_t k) const {
    return w_.release(choice_, source, k);
  }

  void make_jobs(Time until) {
    jobs_.resize(w_.app.xnodes.size());
    for (std::size_t i = 0; i < jobs_.size(); ++i)
      for (int n = 0; nominal(w_.first_source[i], n) < until; ++n) {
        Job j;
        j.xnode = static_cast<int>(i);
        j.n = n;
        j.release = nominal(w_.first_source[i], n);
        j.table = j.release < choice_.change ? 0 : 1;
        const Placement& placed = w_.policy(j.table).placements[i];
        j.xpu = placed.xpu;
        j.key = placed.key_us[at(n) % placed.key_us.size()] * w_.scale;
        if (!placed.hold_us.empty())
          j.hold = placed.hold_us[at(n) % placed.hold_us.size()] * w_.scale;
        j.arrival = j.release;
        for (const int s : w_.app.xnodes[i].sources) {
          // One message is one time, whoever hears it.
          const Time most = w_.app.sources[at(s)].jitter_us * w_.scale;
          j.arrival =
              std::max(j.arrival, nominal(s, n) + most * entry(choice_.jitter, at(s), n, 0) / 255);
        }
        const Time own =
            w_.wcet(j.table == 0 ? w_.tables.app_from : w_.tables.app_to, j.xnode, j.xpu);
        j.work = std::max<Time>(1, own * entry(choice_.work, i, n, 255) / 255);
        // What is off is not executed: it has ended as soon as what it would wait for has.
        if (w_.tables.platform.xpus[at(j.xpu)].id.starts_with("(off)")) {
          j.work = 0;
        } else if (j.table == 0) {
          const Time both = w_.wcet(w_.tables.app_both, j.xnode, j.xpu);
          j.more = (both - j.work) * entry(choice_.grown, i, n, 255) / 255;
        }
        j.left = j.work;
        left_of_first_ += j.table == 0 ? 1 : 0;
        jobs_[i].push_back(j);
      }
  }

  /// When it becomes ready, or -1: not known yet. The activations before of its XNode have ended.
  [[nodiscard]] Time ready(const Job& j) const {
    Time t = std::max(j.arrival, j.release + j.hold);
    if (choice_.drains && j.table == 1) {
      if (left_of_first_ > 0) return -1;
      t = std::max(t, first_ended_);
    }
    for (const HandoverWorld::Before& b : w_.before[at(j.xnode)]) {
      const Job& u = jobs_[at(b.xnode)][at(j.n)];
      if (u.end < 0) return -1;
      t = std::max(t, u.end + b.passes[j.table]);
    }
    const int in_flight = w_.in_flight[at(j.xnode)];
    if (j.n >= in_flight)
      for (const int i : w_.leaves_first[at(j.xnode)]) {
        const Job& left = jobs_[at(i)][at(j.n - in_flight)];
        if (left.end < 0) return -1;
        t = std::max(t, left.end);
      }
    return t;
  }

  /// Whether `a` goes before `b`.
  [[nodiscard]] bool first(const Job& a, const Job& b) const {
    if (a.release + a.key != b.release + b.key) return a.release + a.key < b.release + b.key;
    return choice_.last_first ? a.xnode > b.xnode : a.xnode < b.xnode;
  }

  void grow(Time now) {
    for (auto& of : jobs_)
      for (Job& j : of) {
        if (j.table != 0 || j.end >= 0) continue;
        j.left += j.more;
        j.work += j.more;
      }
    grown_ = now;
  }

  void play() {
    constexpr Time kFar = Time{1} << 62;
    std::vector<Job*> running(w_.tables.platform.xpus.size(), nullptr);
    std::vector<std::size_t> next_of(jobs_.size(), 0);
    std::vector<Time> when(jobs_.size());
    Time now = 0;
    for (;;) {
      // First: what would have ended at t need not.
      if (grown_ < 0 && now >= choice_.grows) grow(now);
      for (Job*& r : running)
        if (r != nullptr && r->left == 0) {
          r->end = now;
          if (r->table == 0) {
            --left_of_first_;
            first_ended_ = now;
          }
          ++next_of[at(r->xnode)];
          r = nullptr;
        }
      // Of each XNode only the first activation that has not ended can be ready.
      for (std::size_t i = 0; i < jobs_.size(); ++i)
        when[i] = next_of[i] < jobs_[i].size() ? ready(jobs_[i][next_of[i]]) : -1;
      for (std::size_t m = 0; m < running.size(); ++m) {
        const Xpu& xpu = w_.tables.platform.xpus[m];
        Job* best = nullptr;
        int open = 0;
        for (std::size_t i = 0; i < jobs_.size(); ++i) {
          if (when[i] < 0 || when[i] > now) continue;
          Job& j = jobs_[i][next_of[i]];
          if (at(j.xpu) != m) continue;
          open += j.start >= 0 ? 1 : 0;
          // With levels who has started goes before who has not and has the same key.
          const bool equal = best != nullptr && j.release + j.key == best->release + best->key;
          if (xpu.levels > 0 && equal && (j.start >= 0) != (best->start >= 0)) {
            if (j.start >= 0) best = &j;
          } else if (best == nullptr || first(j, *best)) {
            best = &j;
          }
        }
        Job*& r = running[m];
        if (best == nullptr || r == best) continue;
        if (r != nullptr) {
          if (!xpu.preemptive || r->release + r->key <= best->release + best->key) continue;
          if (xpu.levels > 0 && open == xpu.levels) continue;
        }
        if (best->start < 0 && (r != nullptr || (xpu.levels > 0 && open > 0)))
          best->left += xpu.preempt_us * w_.scale;
        r = best;
        if (r->start < 0) r->start = now;
      }
      Time next = grown_ < 0 ? std::max(now, choice_.grows) : kFar;
      for (const Time t : when)
        if (t > now) next = std::min(next, t);
      for (const Job* r : running)
        if (r != nullptr) next = std::min(next, now + r->left);
      if (next == kFar) return;
      for (Job* r : running)
        if (r != nullptr) {
          watch(*r, now, next);
          r->left -= next - now;
        }
      now = next;
    }
  }

  /// Notes when the first job passes p's envelope: its last `work - envelope` are beyond.
  void watch(const Job& j, Time now, Time next) {
    if (j.table != 0) return;
    const Time beyond = j.work - w_.wcet(w_.tables.app_from, j.xnode, j.xpu);
    if (beyond <= 0 || j.left - (next - now) >= beyond) return;
    const Time when = std::max(now, now + j.left - beyond);
    if (passed_ < 0 || when < passed_) passed_ = when;
  }

  [[nodiscard]] Time along(const ChainSpec& spec, const HandoverWorld::Way& way) const {
    // knows[n]: the newest release of the source that activation n of the current component knows.
    // Neither it nor ends fall with n, since an XNode's activations are in order.
    const int first = way.empty() ? spec.to : way.front().first;
    std::vector<int> knows(jobs_[at(first)].size());
    std::iota(knows.begin(), knows.end(), 0);
    for (const auto& [u, v] : way) {
      std::vector<int> next(jobs_[at(v)].size(), -1);
      std::size_t k = 0;
      int newest = -1;
      for (std::size_t n = 0; n < next.size(); ++n) {
        const Job& reader = jobs_[at(v)][n];
        if (reader.start < 0) break;
        for (; k < knows.size(); ++k) {
          const Job& wrote = jobs_[at(u)][k];
          if (wrote.end < 0 || wrote.end > reader.start) break;
          newest = knows[k];
        }
        next[n] = newest;
      }
      knows = std::move(next);
    }
    // From the first release on that ends after every reader has started once.
    std::size_t n = 0;
    while (n < knows.size() && knows[n] < 0) ++n;
    if (n == knows.size()) return 0;
    Time worst = 0;
    for (int k = knows[n] + 1;; ++k) {
      while (n < knows.size() && knows[n] < k) ++n;
      if (n == knows.size() || jobs_[at(spec.to)][n].end < 0) return worst;
      worst = std::max(worst, jobs_[at(spec.to)][n].end - nominal(spec.from, k));
    }
  }

  const HandoverWorld& w_;
  HandoverChoice choice_;
  std::vector<std::vector<Job>> jobs_;  ///< [xnode][n]
  Time grown_ = -1, passed_ = -1;
  int left_of_first_ = 0;  ///< jobs of p
  Time first_ended_ = 0;
};

/// `change` and `grows` in ticks.
inline HandoverChoice disturbed(const HandoverWorld& world, std::int64_t change, std::int64_t grows,
                                std::int64_t until, const HandoverDisturbance& how) {
  using Times = HandoverDisturbance::Times;
  using Jitter = HandoverDisturbance::Jitter;
  Random random(how.seed);
  HandoverChoice c;
  c.change = change;
  c.grows = grows;
  c.begin.assign(world.app.clocks.size(), 0);
  for (std::size_t k = 1; k < c.begin.size(); ++k)
    c.begin[k] = static_cast<std::int64_t>(random.below(
        static_cast<std::uint64_t>(std::min(world.hyperperiod, std::int64_t{1} << 31))));
  for (const ClockSpec& clock : world.app.clocks) {
    const auto rate = [&] { return clock.ppm == 0 ? 0 : static_cast<int>(random.below(3)) - 1; };
    c.drift.push_back({rate(), rate(), change});
  }
  const auto byte = [&] { return static_cast<std::uint8_t>(random.below(256)); };
  const auto releases = [&](const SourceSpec& s) {
    return HandoverWorld::at(2 * until / (s.period.num * (world.scale / s.period.den)) +
                             1);  // fast
  };
  for (std::size_t i = 0; i < world.app.xnodes.size(); ++i) {
    const auto count = releases(world.app.sources[HandoverWorld::at(world.first_source[i])]);
    c.work.emplace_back(count, 255);
    c.grown.emplace_back(count, 255);
    for (std::size_t n = 0; n < count && how.times != Times::kWorst; ++n)
      for (auto* of : {&c.work[i][n], &c.grown[i][n]}) {
        const auto which = random.below(how.times == Times::kRandom ? 4 : 2);
        *of = which == 0 ? 255 : which == 1 ? 0 : byte();
      }
  }
  for (const SourceSpec& s : world.app.sources) {
    c.jitter.emplace_back(releases(s), how.jitter == Jitter::kLargest ? 255 : 0);
    for (auto& j : c.jitter.back()) {
      if (how.jitter != Jitter::kRandom) break;
      const auto which = random.below(3);
      j = which == 0 ? 0 : which == 1 ? 255 : byte();
    }
  }
  c.last_first = random.below(2) == 0;
  return c;
}

struct HandoverAttack {
  std::int64_t notice_us = 0;
  std::int64_t plays = 1000;
  std::uint64_t seed = 1;
  int steps = 60;  ///< of a climb, until it begins anew elsewhere
  bool drains = false;
};

struct HandoverFound {
  std::vector<double> fullest;  ///< [chain] largest seen / claimed; 0: nothing is claimed
  double worst = 0;             ///< of all chains
  double settles_us = 0;        ///< longest from S to the end of a job past its key
  double drained_us = 0;        ///< longest from S to the end of p's jobs
  double latest_us = -1e18;     ///< a job after its key
  bool deadlock = false, illegal = false;  ///< the last: a bug of the simulator's
  std::int64_t plays = 0, jobs = 0;
  HandoverChoice choice;  ///< of `worst`
  std::int64_t until = 0;
};

/// Climbs over S, t, execution times and jitter, one chain after the other. `claimed_us` [chain]:
/// nullopt: nothing is claimed.
class HandoverClimb {
 public:
  using Time = std::int64_t;
  /// How near a play comes to what the caller would like to see; climbed every other time.
  using Judge = std::function<Time(const HandoverRun&, const HandoverChoice&)>;

  HandoverClimb(const NaiveTables& tables,
                const std::vector<std::optional<std::int64_t>>& claimed_us,
                const HandoverAttack& attack, Judge judge = {})
      : world_(tables),
        claimed_us_(claimed_us),
        attack_(attack),
        judge_(std::move(judge)),
        random_(attack.seed) {
    found_.fullest.assign(claimed_us.size(), 0);
    Time longest = 0;
    for (const SourceSpec& s : world_.app.sources)
      longest = std::max(longest, s.period.num * (world_.scale / s.period.den));
    // Where releases seldom come round, some of them must do.
    round_ = std::min(world_.hyperperiod, 20 * longest);
    warm_ = std::max(2 * round_, 2 * world_.deepest());
    found_.until = until_ = warm_ + round_ + 3 * world_.deepest() + 3 * longest;
    notice_ = attack.notice_us * world_.scale;
  }

  HandoverFound run() {
    std::size_t target = 0;
    while (found_.plays < attack_.plays) {
      HandoverChoice best = anew();
      auto score = played(best, target);
      for (int step = 0; step < attack_.steps && found_.plays < attack_.plays; ++step) {
        HandoverChoice next = best;
        const auto changes = 1 + random_.below(4);
        for (std::uint64_t k = 0; k < changes; ++k) mutate(next);
        const auto now = played(next, target);
        if (now < score) continue;
        score = now;
        best = std::move(next);
      }
      target = (target + 1) % std::max<std::size_t>(1, claimed_us_.size());
      judging_ = judge_ && !judging_;
    }
    return found_;
  }

 private:
  Time draw(Time bound) {
    return bound <= 1 ? 0
                      : static_cast<Time>(random_.below(
                            static_cast<std::uint64_t>(std::min(bound, (Time{1} << 32) - 1))));
  }

  /// What the climb is for, and then how late jobs are.
  std::pair<Time, Time> played(const HandoverChoice& choice, std::size_t target) {
    const HandoverRun run(world_, until_, choice);
    ++found_.plays;
    found_.jobs += run.completed();
    found_.deadlock |= !run.all_ended();
    found_.illegal |= run.passed() >= 0 && run.passed() < choice.grows;
    const auto us = [&](Time t) {
      return static_cast<double>(t) / static_cast<double>(world_.scale);
    };
    found_.settles_us = std::max(found_.settles_us, us(run.settles()));
    found_.drained_us = std::max(found_.drained_us, us(run.drained()));
    found_.latest_us = std::max(found_.latest_us, us(run.latest()));
    const Time judged = judge_ ? judge_(run, choice) : 0;
    Time sought = 0;
    for (std::size_t c = 0; c < claimed_us_.size(); ++c) {
      if (!claimed_us_[c] && c != target) continue;
      const Time seen = run.seen(c);
      if (c == target) sought = seen;
      if (!claimed_us_[c]) continue;
      const double full = us(seen) / static_cast<double>(*claimed_us_[c]);
      found_.fullest[c] = std::max(found_.fullest[c], full);
      if (full > found_.worst) {
        found_.worst = full;
        found_.choice = choice;
      }
    }
    return {judging_ ? judged : sought, run.latest()};
  }

  HandoverChoice anew() {
    HandoverDisturbance how;
    how.seed = random_.next();
    how.times =
        static_cast<HandoverDisturbance::Times>(random_.below(2) == 0 ? 0 : random_.below(3));
    how.jitter = static_cast<HandoverDisturbance::Jitter>(random_.below(3));
    HandoverChoice c = disturbed(world_, 0, 0, until_, how);
    c.drains = attack_.drains;
    c.change = a_change(c);
    c.grows = a_growth(c);
    return c;
  }

  /// At a release, right after one, or anywhere.
  Time a_change(const HandoverChoice& c) {
    const auto which = random_.below(4);
    if (which == 0) return warm_ + draw(round_);
    const int index = static_cast<int>(draw(static_cast<Time>(world_.app.sources.size())));
    const SourceSpec& s = world_.app.sources[HandoverWorld::at(index)];
    const Time period = s.period.num * (world_.scale / s.period.den);
    const Time first = world_.release(c, index, 0);
    const Time n = (warm_ + draw(round_) - first) / period + 1;
    return world_.release(c, index, n) + (which == 1 ? 1 : 0);
  }
  Time a_growth(const HandoverChoice& c) {
    switch (random_.below(4)) {
      case 0:
        return c.change;
      case 1:
        return c.change - notice_;
      case 2: {  // on or beside a key of p
        const auto i = HandoverWorld::at(draw(static_cast<Time>(world_.app.xnodes.size())));
        const auto& keys = world_.tables.from.placements[i].key_us;
        const int source = world_.first_source[i];
        const SourceSpec& s = world_.app.sources[HandoverWorld::at(source)];
        const Time period = s.period.num * (world_.scale / s.period.den);
        const Time first = world_.release(c, source, 0);
        const Time about = c.change - draw(notice_ + 1);
        const Time n =
            std::max<Time>(0, (about - first) / period - draw(2 + world_.deepest() / period));
        const Time key = world_.release(c, source, n) +
                         keys[HandoverWorld::at(n) % keys.size()] * world_.scale + draw(3) - 1;
        return std::clamp(key, c.change - notice_, c.change);
      }
      default:
        return c.change - draw(notice_ + 1);
    }
  }

  void mutate(HandoverChoice& c) {
    const auto some = [&](std::vector<std::vector<std::uint8_t>>& of) -> std::uint8_t* {
      auto& row = of[HandoverWorld::at(draw(static_cast<Time>(of.size())))];
      // Near the change: what happens long before matters to nobody.
      const Time count = static_cast<Time>(row.size());
      const Time from = count * (warm_ - world_.deepest()) / until_;
      return &row[HandoverWorld::at(std::min(count - 1, from + draw(count - from)))];
    };
    const auto another = [&] {
      const auto which = random_.below(3);
      return static_cast<std::uint8_t>(which == 0 ? 0 : which == 1 ? 255 : random_.below(256));
    };
    switch (random_.below(8)) {
      case 0: {  // all of it, as it is
        const Time change = a_change(c);
        c.grows += change - c.change;
        c.change = change;
        break;
      }
      case 1:
        c.grows = a_growth(c);
        break;
      case 2: {
        const Time by = draw(4 * world_.scale) - 2 * world_.scale;
        c.change += by;
        c.grows =
            std::clamp(c.grows + (random_.below(2) == 0 ? by : 0), c.change - notice_, c.change);
        break;
      }
      case 3:
      case 4:
        *some(c.work) = another();
        break;
      case 5:
        *some(c.grown) = another();
        break;
      case 6:
        *some(c.jitter) = another();
        break;
      default: {
        const std::size_t clock =
            HandoverWorld::at(draw(static_cast<Time>(world_.app.clocks.size())));
        if (world_.app.clocks[clock].ppm > 0 && random_.below(2) == 0) {
          HandoverChoice::Drift& drift = c.drift[clock];
          (random_.below(2) == 0 ? drift.before : drift.after) =
              static_cast<int>(random_.below(3)) - 1;
          drift.bend = c.change - c.begin[clock] + draw(2 * round_) - round_;
        }
        if (c.begin.size() > 1 && random_.below(2) == 0) {  // the others' phase
          Time& begin = c.begin[1 + HandoverWorld::at(draw(static_cast<Time>(c.begin.size()) - 1))];
          begin = random_.below(2) == 0 ? draw(round_) : std::max<Time>(0, begin + draw(9) - 4);
        }
        if (random_.below(4) == 0) c.last_first = !c.last_first;
        // All activations of one XNode.
        auto& row = c.work[HandoverWorld::at(draw(static_cast<Time>(c.work.size())))];
        row.assign(row.size(), another());
      }
    }
  }

  HandoverWorld world_;
  std::vector<std::optional<std::int64_t>> claimed_us_;
  HandoverAttack attack_;
  Judge judge_;
  bool judging_ = false;
  Random random_;
  Time round_ = 0, warm_ = 0, until_ = 0, notice_ = 0;
  HandoverFound found_;
};

}  // namespace xauto::solver::keys

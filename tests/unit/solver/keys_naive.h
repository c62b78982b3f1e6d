// SPDX-License-Identifier: Apache-2.0
// Plays a Policy straight from the text of docs/keys.md, event by event over all jobs of
// a few hyperperiods, and tells what was broken. Shares nothing with solver/keys.
//
// Times are integers of 1 / `scale` us. One clock's release n is at begin + slow * n * period, with
// `slow` near 1 where clocks drift.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/random.h"

namespace xauto::solver::keys {

/// How one run is disturbed.
struct Disturbance {
  std::uint64_t seed = 1;
  bool worst_times = false;     ///< every job its WCET
  bool shortest_times = false;  ///< else: some jobs nearly nothing
  bool drift = true;            ///< clocks at the ends of their ppm
  /// Which releases of the sources that may are urgent: bit n mod 32 of release n, where that is not
  /// too soon. 0: none; 1: at random.
  std::uint32_t urgent = 1;
};

class NaiveRun {
 public:
  using Time = std::int64_t;

  NaiveRun(const AppSpec& app, const Platform& platform, const Policy& policy, int activations,
           const Disturbance& how)
      : app_(app), platform_(platform), policy_(policy), random_(how.seed) {
    for (const SourceSpec& s : app.sources) scale_ = std::lcm(scale_, s.period.den);
    scale_ *= 8;  // so that phases and drift fall between microseconds
    make_clocks(how);
    components();
    mark(activations, how);
    make_jobs(activations, how);
  }

  /// What was broken first, or nothing.
  std::string run() {
    play();
    for (const Job& j : jobs_) {
      if (j.end < 0) continue;
      if (j.end > j.release + j.key)
        return "XNode " + app_.xnodes[at(j.xnode)].name + " activation " + std::to_string(j.n) +
               " ends " + std::to_string(j.end - j.release - j.key) + "/" + std::to_string(scale_) +
               " us after its key";
    }
    for (std::size_t c = 0; c < app_.chains.size(); ++c) {
      const Time worst = chain(app_.chains[c]);
      const Time urgent = urgent_seen_;
      if (urgent > policy_.chains[c].urgent_worst_case_us.value_or(kMaxTimeUs) * scale_)
        return "chain " + app_.chains[c].name + " takes an urgent release " +
               std::to_string(static_cast<double>(urgent) / static_cast<double>(scale_)) +
               " us, claimed " + std::to_string(*policy_.chains[c].urgent_worst_case_us);
      if (worst > policy_.chains[c].worst_case_us * scale_)
        return "chain " + app_.chains[c].name + " takes " +
               std::to_string(static_cast<double>(worst) / static_cast<double>(scale_)) +
               " us, claimed " + std::to_string(policy_.chains[c].worst_case_us);
    }
    return {};
  }
  /// Longest seen, of the last run, in us rounded down.
  Time seen(std::size_t c) const { return chain(app_.chains[c]) / scale_; }
  int completed() const {
    return static_cast<int>(
        std::count_if(jobs_.begin(), jobs_.end(), [](const Job& j) { return j.end >= 0; }));
  }

 private:
  struct Job {
    int xnode = 0, n = 0, xpu = 0;
    Time release = 0, key = 0, hold = 0, arrival = 0, left = 0;
    Time start = -1, end = -1;
    bool paid = false;
  };
  static std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

  void make_clocks(const Disturbance& how) {
    for (const ClockSpec& c : app_.clocks) {
      begin_.push_back(static_cast<Time>(random_.below(100 * static_cast<std::uint64_t>(scale_))));
      const double ppm = static_cast<double>(c.ppm) * 1e-6;
      slow_.push_back(!how.drift ? 1.0 : random_.below(2) == 0 ? 1 - ppm : 1 + ppm);
    }
  }

  Time nominal(int source, std::int64_t k) const {
    const SourceSpec& s = app_.sources[at(source)];
    const double t = (static_cast<double>(s.offset_us) + static_cast<double>(k) *
                                                             static_cast<double>(s.period.num) /
                                                             static_cast<double>(s.period.den)) *
                     static_cast<double>(scale_);
    const auto exact = s.offset_us * scale_ + k * s.period.num * (scale_ / s.period.den);
    return begin_[at(s.clock)] + (slow_[at(s.clock)] == 1.0
                                      ? exact
                                      : static_cast<Time>(std::llround(t * slow_[at(s.clock)])));
  }

  void components() {
    component_.resize(app_.xnodes.size());
    for (std::size_t i = 0; i < component_.size(); ++i) component_[i] = static_cast<int>(i);
    for (std::size_t round = 0; round < component_.size(); ++round)
      for (const auto& [u, v] : app_.edges)
        component_[at(u)] = component_[at(v)] = std::min(component_[at(u)], component_[at(v)]);
    first_source_.assign(app_.xnodes.size(), -1);
    for (std::size_t i = 0; i < component_.size(); ++i)
      for (const int s : app_.xnodes[i].sources) {
        int& first = first_source_[at(component_[i])];
        if (first < 0 || app_.sources[at(s)].offset_us < app_.sources[at(first)].offset_us)
          first = s;
      }
  }

  /// Which releases are urgent, of each source.
  void mark(int activations, const Disturbance& how) {
    urgent_.resize(app_.sources.size());
    for (std::size_t s = 0; s < app_.sources.size(); ++s) {
      const SourceSpec& source = app_.sources[s];
      if (!source.urgent) continue;
      Time last = -1;
      for (Time n = 0; n < 40 * activations; ++n) {
        const bool wanted =
            how.urgent == 1 ? random_.below(2) == 0 : (how.urgent >> (n % 32) & 1U) != 0;
        // As the formats say it: two of them are at least every_us apart.
        const bool far = last < 0 || (n - last) * source.period.num >=
                                         source.urgent->every_us * source.period.den;
        urgent_[s].push_back(wanted && far ? 1 : 0);
        if (wanted && far) last = n;
      }
    }
  }
  [[nodiscard]] Time sooner(int xnode, int n) const {
    for (std::size_t s = 0; s < app_.sources.size(); ++s) {
      if (urgent_[s].empty() || urgent_[s][at(n)] == 0) continue;
      if (const std::string& marks = app_.sources[s].urgent->marked_by; !marks.empty()) {
        for (const auto& [u, v] : app_.edges)
          if (app_.xnodes[at(u)].module == marks && app_.xnodes[at(v)].module != marks &&
              leads(v, xnode))
            return app_.sources[s].urgent->by_us * scale_;
        continue;
      }
      for (std::size_t r = 0; r < app_.xnodes.size(); ++r)
        if (std::count(app_.xnodes[r].sources.begin(), app_.xnodes[r].sources.end(), s) > 0 &&
            leads(static_cast<int>(r), xnode))
          return app_.sources[s].urgent->by_us * scale_;
    }
    return 0;
  }

  void make_jobs(int activations, const Disturbance& how) {
    Time horizon = 0;
    for (std::size_t s = 0; s < app_.sources.size(); ++s)
      horizon = std::max(horizon, nominal(static_cast<int>(s), activations));
    jobs_of_.resize(app_.xnodes.size());
    std::vector<std::vector<Time>> late(app_.sources.size());
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i) {
      const int source = first_source_[at(component_[i])];
      const Placement& placed = policy_.placements[i];
      for (int n = 0; nominal(source, n) < horizon; ++n) {
        Job j;
        j.xnode = static_cast<int>(i);
        j.n = n;
        j.xpu = placed.xpu;
        j.release = nominal(source, n);
        j.key = placed.key_us[at(n) % placed.key_us.size()] * scale_;
        if (!placed.hold_us.empty())
          j.hold = placed.hold_us[at(n) % placed.hold_us.size()] * scale_;
        const Time moved = sooner(j.xnode, n);
        j.key -= moved;
        j.hold = std::max<Time>(0, j.hold - moved);
        j.arrival = j.release;
        for (const int s : app_.xnodes[i].sources) {
          // One message is one time, whoever hears it.
          auto& times = late[at(s)];
          while (static_cast<int>(times.size()) <= n) {
            const Time most = app_.sources[at(s)].jitter_us * scale_;
            const std::uint64_t which = random_.below(3);
            times.push_back(which == 0   ? 0
                            : which == 1 ? most
                                         : static_cast<Time>(random_.below(
                                               static_cast<std::uint64_t>(most + 1))));
          }
          j.arrival = std::max(j.arrival, nominal(s, n) + times[at(n)]);
        }
        const Time work = *app_.xnodes[i].wcet_on(platform_.xpus[at(placed.xpu)].type) * scale_;
        const std::uint64_t which = how.worst_times ? 0 : random_.below(how.shortest_times ? 2 : 4);
        j.left = which == 0 ? work
                 : which == 1
                     ? 1
                     : 1 + static_cast<Time>(random_.below(static_cast<std::uint64_t>(work)));
        jobs_of_[i].push_back(static_cast<int>(jobs_.size()));
        jobs_.push_back(j);
      }
    }
  }

  /// When it becomes ready, or -1: not known yet.
  Time ready(const Job& j) const {
    Time t = std::max(j.arrival, j.release + j.hold);
    for (std::size_t e = 0; e < app_.edges.size(); ++e) {
      const auto [u, v] = app_.edges[e];
      if (v != j.xnode) continue;
      const Job& before = jobs_[at(jobs_of_[at(u)][at(j.n)])];
      if (before.end < 0) return -1;
      Time passes = 0;
      for (const TransferSpec& tr : app_.transfers)
        if (at(tr.edge) == e && tr.from_type == platform_.xpus[at(before.xpu)].type &&
            tr.to_type == platform_.xpus[at(j.xpu)].type)
          passes = tr.transfer_us * scale_;
      t = std::max(t, before.end + passes);
    }
    for (const auto& [u, v] : policy_.order) {
      if (v != j.xnode) continue;
      const Job& before = jobs_[at(jobs_of_[at(u)][at(j.n)])];
      if (before.end < 0) return -1;
      t = std::max(t, before.end);
    }
    if (j.n > 0) {
      const Job& last = jobs_[at(jobs_of_[at(j.xnode)][at(j.n - 1)])];
      if (last.end < 0) return -1;
      t = std::max(t, last.end);
    }
    std::int64_t in_flight = 1;
    const std::string& module = app_.xnodes[at(j.xnode)].module;
    for (const ModuleSpec& m : app_.modules)
      if (m.name == module) in_flight = m.max_in_flight;
    const bool entry = std::none_of(app_.edges.begin(), app_.edges.end(), [&](const auto& e) {
      return e.second == j.xnode && app_.xnodes[at(e.first)].module == module;
    });
    if (entry && j.n >= in_flight)
      for (std::size_t i = 0; i < app_.xnodes.size(); ++i) {
        if (app_.xnodes[i].module != module) continue;
        const Job& before = jobs_[at(jobs_of_[i][at(j.n - in_flight)])];
        if (before.end < 0) return -1;
        t = std::max(t, before.end);
      }
    return t;
  }

  void play() {
    constexpr Time kFar = Time{1} << 62;
    std::vector<int> running(platform_.xpus.size(), -1);
    Time now = 0;
    for (;;) {
      // What ends now.
      for (int& r : running)
        if (r >= 0 && jobs_[at(r)].left == 0) {
          jobs_[at(r)].end = now;
          r = -1;
        }
      std::vector<Time> when(jobs_.size(), -1);
      for (std::size_t k = 0; k < jobs_.size(); ++k)
        if (jobs_[k].end < 0) when[k] = ready(jobs_[k]);
      for (std::size_t m = 0; m < running.size(); ++m) {
        const Xpu& xpu = platform_.xpus[m];
        int best = -1, open = 0;
        for (std::size_t k = 0; k < jobs_.size(); ++k) {
          const Job& j = jobs_[k];
          if (j.end >= 0 || at(j.xpu) != m || when[k] < 0 || when[k] > now) continue;
          open += j.start >= 0 ? 1 : 0;
          const Time ahead =
              best < 0 ? 1 : jobs_[at(best)].release + jobs_[at(best)].key - j.release - j.key;
          // With levels who has started goes before who has not and has the same key.
          if (ahead > 0 ||
              (ahead == 0 && xpu.levels > 0 && j.start >= 0 && jobs_[at(best)].start < 0))
            best = static_cast<int>(k);
        }
        int& r = running[m];
        if (best < 0 || r == best) continue;
        if (r >= 0) {
          const Job& has = jobs_[at(r)];
          if (!xpu.preemptive || (xpu.levels > 0 && open == xpu.levels) ||
              has.release + has.key <= jobs_[at(best)].release + jobs_[at(best)].key)
            continue;
          if (!jobs_[at(best)].paid && jobs_[at(best)].start < 0)
            jobs_[at(best)].left += xpu.preempt_us * scale_;
          jobs_[at(best)].paid = true;
        } else if (xpu.levels > 0 && open > 0 && jobs_[at(best)].start < 0) {
          jobs_[at(best)].left += xpu.preempt_us * scale_;
        }
        r = best;
        if (jobs_[at(r)].start < 0) jobs_[at(r)].start = now;
      }
      Time next = kFar;
      for (std::size_t k = 0; k < jobs_.size(); ++k)
        if (when[k] > now) next = std::min(next, when[k]);
      for (const int r : running)
        if (r >= 0) next = std::min(next, now + jobs_[at(r)].left);
      if (next == kFar) return;
      for (const int r : running)
        if (r >= 0) jobs_[at(r)].left -= next - now;
      now = next;
    }
  }

  /// All ways from the root of `path` through samples to `to`.
  void ways(int v, int to, std::vector<std::pair<int, int>>& way, std::vector<char>& seen,
            std::vector<std::vector<std::pair<int, int>>>& out) const {
    if (leads(v, to)) out.push_back(way);
    for (const auto& [u, w] : app_.samples) {
      if (!leads(v, u) || seen[at(component_[at(w)])] != 0) continue;
      seen[at(component_[at(w)])] = 1;
      way.emplace_back(u, w);
      ways(w, to, way, seen, out);
      way.pop_back();
      seen[at(component_[at(w)])] = 0;
    }
  }
  bool leads(int a, int b) const {
    if (a == b) return true;
    return std::any_of(app_.edges.begin(), app_.edges.end(),
                       [&](const auto& e) { return e.first == a && leads(e.second, b); });
  }

  /// Longest from a release to the end of the first job that knows it.
  Time chain(const ChainSpec& spec) const {
    Time worst = 0;
    urgent_seen_ = 0;
    for (std::size_t r = 0; r < app_.xnodes.size(); ++r) {
      const auto& heard = app_.xnodes[r].sources;
      if (std::find(heard.begin(), heard.end(), spec.from) == heard.end()) continue;
      std::vector<std::vector<std::pair<int, int>>> all;
      std::vector<std::pair<int, int>> way;
      std::vector<char> seen(app_.xnodes.size(), 0);
      seen[at(component_[r])] = 1;
      ways(static_cast<int>(r), spec.to, way, seen, all);
      for (const auto& path : all) worst = std::max(worst, along(spec, path));
    }
    return worst;
  }

  Time along(const ChainSpec& spec, const std::vector<std::pair<int, int>>& path) const {
    // knows[n]: the newest release of the source that activation n of the current component knows.
    const int first = path.empty() ? spec.to : path.front().first;
    std::vector<int> knows(jobs_of_[at(first)].size());
    for (std::size_t n = 0; n < knows.size(); ++n) knows[n] = static_cast<int>(n);
    int last = first;
    for (std::size_t s = 0; s < path.size(); ++s) {
      const auto [u, v] = path[s];
      std::vector<int> next(jobs_of_[at(v)].size(), -1);
      for (std::size_t n = 0; n < next.size(); ++n) {
        const Job& reader = jobs_[at(jobs_of_[at(v)][n])];
        if (reader.start < 0) continue;
        for (std::size_t k = 0; k < knows.size(); ++k) {
          const Job& wrote = jobs_[at(jobs_of_[at(u)][k])];
          if (wrote.end >= 0 && wrote.end <= reader.start) next[n] = std::max(next[n], knows[k]);
        }
      }
      knows = std::move(next);
      last = s + 1 < path.size() ? path[s + 1].first : spec.to;
    }
    Time worst = 0;
    // From the first release on that ends after every reader has started once.
    const auto heard_first = std::find_if(knows.begin(), knows.end(), [](int k) { return k >= 0; });
    if (heard_first == knows.end()) return 0;
    for (int k = *heard_first + 1; at(k) < jobs_of_[at(first)].size(); ++k)
      for (std::size_t n = 0; n < knows.size(); ++n)
        if (knows[n] >= k) {
          const Job& j = jobs_[at(jobs_of_[at(last)][n])];
          if (j.end < 0) break;
          worst = std::max(worst, j.end - nominal(spec.from, k));
          const auto& urgent = urgent_[at(spec.from)];
          if (!urgent.empty() && urgent[at(k)] != 0)
            urgent_seen_ = std::max(urgent_seen_, j.end - nominal(spec.from, k));
          break;
        }
    return worst;
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Policy& policy_;
  Random random_;
  Time scale_ = 1;
  std::vector<Time> begin_;
  std::vector<double> slow_;
  std::vector<std::vector<char>> urgent_;  ///< [source][release]; empty: none is
  mutable Time urgent_seen_ = 0;           ///< by the last chain()
  std::vector<int> component_, first_source_;
  std::vector<std::vector<int>> jobs_of_;
  std::vector<Job> jobs_;
};

/// `plays` runs, each disturbed its own way: a third at WCETs, a third far below them. What was broken first, or nothing.
inline std::string play_naively(const AppSpec& app, const Platform& platform, const Policy& policy,
                                int plays, int activations, std::int64_t& jobs) {
  for (int k = 0; k < plays; ++k) {
    Disturbance how;
    how.seed = static_cast<std::uint64_t>(k) + 1;
    how.worst_times = k % 3 == 0;
    how.shortest_times = k % 3 == 1;
    NaiveRun run(app, platform, policy, activations, how);
    const std::string broken = run.run();
    jobs += run.completed();
    if (!broken.empty()) return "run " + std::to_string(k) + ": " + broken;
  }
  return {};
}

}  // namespace xauto::solver::keys

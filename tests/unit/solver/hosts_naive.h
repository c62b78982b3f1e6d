// SPDX-License-Identifier: Apache-2.0
// An app on hosts whose clocks are wrong, played in real time. Shares no code with the solver: it knows what a host does
// (the ready job of the smallest key runs, keys and holds are read on its own clock), and what a message is.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "base/index.h"
#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

#include "problem_random.h"

namespace xauto::solver::keys::test {

/// A clock of a host: off from true time by `off`, and by a triangle whose slopes are its rate's error.
struct HostClock {
  double off = 0, amplitude = 0, rate = 0;
  [[nodiscard]] double reads(double real) const {
    if (rate == 0 || amplitude == 0) return real + off;
    const double turn = 4 * amplitude / rate, place = real - turn * std::floor(real / turn);
    const double triangle =
        place < turn / 2 ? rate * place - amplitude : 3 * amplitude - rate * place;
    return real + off + triangle;
  }
  [[nodiscard]] double when(double reading) const {
    double low = reading - off - 2 * amplitude - 1, high = reading - off + 2 * amplitude + 1;
    for (int step = 0; step < 80; ++step) {
      const double middle = (low + high) / 2;
      (reads(middle) < reading ? low : high) = middle;
    }
    return high;
  }
};

struct HostsPlay {
  std::vector<HostClock> clocks;  ///< [host]
  double link_us = 0;             ///< every message between hosts is on its way for so long
  double less_percent = 0;        ///< jobs take up to so much less than their WCET
  int activations = 0;            ///< of each source
};

struct HostsPlayed {
  double latest_us = -1e300;  ///< end - key, on the host's clock, of the worst job
  std::vector<double>
      chain_us;  ///< [chain] longest, from the source's number to the end host's clock
};

/// Keys, holds and edges as in the policy; no order pairs, no urgent releases.
class HostsWorld {
 public:
  HostsWorld(const AppSpec& app, const Platform& platform, const Policy& policy,
             const HostsPlay& play, solver::test::Dice& dice)
      : app_(app), platform_(platform), policy_(policy), play_(play), dice_(dice) {
    component_.resize(app.xnodes.size());
    for (std::size_t i = 0; i < component_.size(); ++i) component_[i] = static_cast<int>(i);
    for (bool joined = true; joined;) {
      joined = false;
      const auto join = [&](int u, int v) {
        const int least = std::min(component_[at(u)], component_[at(v)]);
        joined = joined || component_[at(u)] != least || component_[at(v)] != least;
        component_[at(u)] = component_[at(v)] = least;
      };
      for (const auto& [u, v] : app.edges) join(u, v);
      for (std::size_t i = 0; i < app.xnodes.size(); ++i)
        for (std::size_t j = 0; j < i; ++j)
          if (app.xnodes[i].module == app.xnodes[j].module)
            join(static_cast<int>(j), static_cast<int>(i));
    }
    for (std::size_t i = 0; i < app.xnodes.size(); ++i)
      for (const int s : app.xnodes[i].sources) {
        auto [there, fresh] = source_of_.try_emplace(component_[i], s);
        if (!fresh && app.sources[at(s)].offset_us < app.sources[at(there->second)].offset_us)
          there->second = s;
      }
    real_phase_.resize(app.clocks.size());
    real_rate_.resize(app.clocks.size(), 1);
    for (std::size_t c = 1; c < app.clocks.size(); ++c) {
      real_phase_[c] = dice.roll(0, 20'000);
      real_rate_[c] = 1 + static_cast<double>(app.clocks[c].ppm) * dice.roll(-1, 1) * 1e-6;
    }
  }

  HostsPlayed run() {
    make_jobs();
    played_.chain_us.assign(app_.chains.size(), -1);
    knows_.assign(app_.xnodes.size(), {});
    for (;;) {
      const double next = next_event();
      if (next == kNever) break;
      advance(next);
    }
    chains();
    return played_;
  }

 private:
  static constexpr double kNever = std::numeric_limits<double>::infinity();
  static constexpr double kSame = 1e-7, kBefore = -1e6;  ///< a clock that is ahead begins before 0

  /// Whoever would have read the first releases was not yet there.
  static constexpr int kFirst = 4;

  struct Job {
    int xnode = 0, n = 0;
    double key = 0, ready = kNever, left = 0, ended = kNever, began = kNever;
  };

  [[nodiscard]] int host(int xnode) const {
    return platform_.xpus[at(policy_.placements[at(xnode)].xpu)].host;
  }
  [[nodiscard]] const HostClock& clock(int xnode) const { return play_.clocks[at(host(xnode))]; }
  [[nodiscard]] double period(int source) const {
    return static_cast<double>(app_.sources[at(source)].period.num) /
           static_cast<double>(app_.sources[at(source)].period.den);
  }
  /// One host reads a clock for all: that of the first XNode that hears one of its sources.
  [[nodiscard]] double number(int source, int n) const {
    const SourceSpec& s = app_.sources[at(source)];
    const double grid = static_cast<double>(s.offset_us) + period(source) * n;
    if (s.clock == 0) return grid;
    const double real = real_phase_[at(s.clock)] + grid / real_rate_[at(s.clock)];
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
      if (std::ranges::any_of(app_.xnodes[i].sources,
                              [&](int other) { return app_.sources[at(other)].clock == s.clock; }))
        return clock(static_cast<int>(i)).reads(real);
    return real;
  }

  void make_jobs() {
    jobs_.resize(app_.xnodes.size());
    double least = kNever;
    for (const SourceSpec& s : app_.sources)
      least =
          std::min(least, static_cast<double>(s.period.num) / static_cast<double>(s.period.den));
    for (std::size_t i = 0; i < jobs_.size(); ++i) {
      const Placement& placed = policy_.placements[i];
      const int source = source_of_.at(component_[i]);
      const auto count = static_cast<int>(std::ceil(least * play_.activations / period(source)));
      for (int n = 0; n < count; ++n) {
        const std::size_t entry = static_cast<std::size_t>(n) % placed.key_us.size();
        Job job{static_cast<int>(i), n};
        job.key = number(source, n) + static_cast<double>(placed.key_us[entry]);
        const auto wcet = static_cast<double>(
            app_.xnodes[i].wcet_on(platform_.xpus[at(placed.xpu)].type).value());
        job.left = wcet * (1 - play_.less_percent * dice_.roll(0, 100) / 10'000);
        jobs_[i].push_back(job);
      }
    }
  }

  /// Real instant from which it may start; kNever: not known yet.
  [[nodiscard]] double ready(const Job& job) const {
    const int i = job.xnode;
    const Placement& placed = policy_.placements[at(i)];
    const int source = source_of_.at(component_[at(i)]);
    double from = kBefore;
    if (!placed.hold_us.empty()) {
      const std::size_t entry = static_cast<std::size_t>(job.n) % placed.hold_us.size();
      from = clock(i).when(number(source, job.n) + static_cast<double>(placed.hold_us[entry]));
    }
    for (const int s : app_.xnodes[at(i)].sources)  // as late as it may be, by the reader's clock
      from = std::max(from, clock(i).when(number(s, job.n) +
                                          static_cast<double>(app_.sources[at(s)].jitter_us)));
    for (const auto& [u, v] : app_.edges)
      if (v == i) {
        const double sent = jobs_[at(u)][at(job.n)].ended;
        if (sent == kNever) return kNever;
        from = std::max(from, sent + transfer(u, v) + (host(u) != host(v) ? play_.link_us : 0));
        if (host(u) != host(v)) from = std::max(from, clock(i).when(number(source, job.n)));
      }
    if (job.n > 0) {
      if (jobs_[at(i)][at(job.n - 1)].ended == kNever) return kNever;
      from = std::max(from, jobs_[at(i)][at(job.n - 1)].ended);
    }
    return enters(i) ? std::max(from, room(i, job.n)) : from;
  }

  [[nodiscard]] double transfer(int u, int v) const {
    double us = 0;
    for (const TransferSpec& t : app_.transfers)
      if (app_.edges[at(t.edge)] == std::pair(u, v) &&
          platform_.xpus[at(policy_.placements[at(u)].xpu)].type == t.from_type &&
          platform_.xpus[at(policy_.placements[at(v)].xpu)].type == t.to_type)
        us = static_cast<double>(t.transfer_us);
    return us;
  }

  [[nodiscard]] bool enters(int i) const {
    return std::ranges::none_of(app_.edges, [&](const auto& edge) {
      return edge.second == i && app_.xnodes[at(edge.first)].module == app_.xnodes[at(i)].module;
    });
  }

  /// When the activation that has to leave the module before has left.
  [[nodiscard]] double room(int i, int n) const {
    double from = kBefore;
    for (const ModuleSpec& m : app_.modules) {
      if (m.name != app_.xnodes[at(i)].module || n < m.max_in_flight) continue;
      for (std::size_t x = 0; x < app_.xnodes.size(); ++x)
        if (app_.xnodes[x].module == m.name)
          from = std::max(from, jobs_[x][at(n - static_cast<int>(m.max_in_flight))].ended);
    }
    return from;
  }

  /// Runs what runs until the next instant at which something may change; kNever: all has ended.
  double next_event() {
    double next = kNever;
    for (std::size_t m = 0; m < platform_.xpus.size(); ++m) {
      Job* best = running(m);
      const bool may_change = best == nullptr || platform_.xpus[m].preemptive;
      for (std::size_t i = 0; i < jobs_.size(); ++i) {
        if (at(policy_.placements[i].xpu) != m) continue;
        for (Job& job : jobs_[i]) {
          if (job.ended < kNever) continue;
          job.ready = ready(job);
          if (job.ready == kNever) break;
          if (job.ready > now_ + kSame)
            next = std::min(next, job.ready);
          else if (best == nullptr || (may_change && job.key < best->key))
            best = &job;
          break;  // the next activation waits for this one
        }
      }
      if (best == nullptr) continue;
      start(m, *best);
      next = std::min(next, now_ + best->left);
    }
    return next;
  }

  [[nodiscard]] Job* running(std::size_t m) {
    const auto found = on_.find(m);
    return found == on_.end() || found->second->ended < kNever ? nullptr : found->second;
  }

  void start(std::size_t m, Job& job) {
    Job* before = running(m);
    if (before == &job) return;
    if (job.began == kNever) {
      job.began = now_;
      if (before != nullptr) job.left += static_cast<double>(platform_.xpus[m].preempt_us);
      read(job);
    }
    on_[m] = &job;
  }

  void advance(double next) {
    for (auto& [m, job] : on_) {
      if (job->ended < kNever) continue;
      job->left -= next - now_;
      if (job->left <= kSame) {
        job->ended = next;
        played_.latest_us = std::max(played_.latest_us, clock(job->xnode).reads(next) - job->key);
      }
    }
    now_ = next;
  }

  /// What it samples: of each the newest result that is on its host.
  void read(const Job& job) {
    for (const auto& [u, v] : app_.samples) {
      if (v != job.xnode) continue;
      int newest = -1;
      for (const Job& sent : jobs_[at(u)])
        if (sent.ended < kNever &&
            sent.ended + (host(u) != host(v) ? play_.link_us : 0) <= now_ + kSame)
          newest = std::max(newest, sent.n);
      knows_[at(v)][{u, job.n}] = newest;
    }
  }

  /// The newest activation of source `s` that `xnode` of activation n knows, along any way; -1: none.
  [[nodiscard]] int known(int xnode, int n, int s, std::vector<int> seen) const {
    if (std::ranges::find(seen, component_[at(xnode)]) != seen.end()) return -1;
    int newest = -1;
    std::vector<int> behind{xnode};  // what it hears by edges, itself included
    for (std::size_t k = 0; k < behind.size(); ++k)
      for (const auto& [u, v] : app_.edges)
        if (v == behind[k] && std::ranges::find(behind, u) == behind.end()) behind.push_back(u);
    seen.push_back(component_[at(xnode)]);
    for (const int x : behind) {
      if (std::ranges::count(app_.xnodes[at(x)].sources, s) > 0) newest = std::max(newest, n);
      for (const auto& [from, activation] : knows_[at(x)])
        if (from.second == n && activation >= 0)
          newest = std::max(newest, known(from.first, activation, s, seen));
    }
    return newest;
  }

  void chains() {
    for (std::size_t c = 0; c < app_.chains.size(); ++c) {
      const ChainSpec& chain = app_.chains[c];
      int next = 0;  // release whose first result is looked for
      for (const Job& job : jobs_[at(chain.to)]) {
        const int newest = known(chain.to, job.n, chain.from, {});
        for (; next <= newest; ++next) {
          if (next < kFirst) continue;
          played_.chain_us[c] = std::max(
              played_.chain_us[c], clock(chain.to).reads(job.ended) - number(chain.from, next));
        }
      }
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Policy& policy_;
  const HostsPlay& play_;
  solver::test::Dice& dice_;
  std::vector<int> component_;
  std::map<int, int> source_of_;  ///< [component] the earliest
  std::vector<double> real_phase_, real_rate_;
  std::vector<std::vector<Job>> jobs_;
  std::map<std::size_t, Job*> on_;
  std::vector<std::map<std::pair<int, int>, int>> knows_;  ///< [reader] (u, own n) -> n of u
  double now_ = kBefore;
  HostsPlayed played_;
};

}  // namespace xauto::solver::keys::test

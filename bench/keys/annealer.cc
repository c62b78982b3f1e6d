// SPDX-License-Identifier: Apache-2.0
#include "bench/keys/annealer.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>

#include "base/clock.h"
#include "base/index.h"
#include "model/components.h"
#include "solver/keys/check.h"
#include "solver/random.h"

namespace xauto::bench {
namespace {

/// Hyperperiods that are simulated, and jobs if these are more. Two at two thirds of them have to be
/// alike: by then the beginning is forgotten, and the end, after which nothing comes, is far.
constexpr std::int64_t kRounds = 6, kJobs = 2'000;
/// A domain with more jobs in them is taken apart: each component by itself, once per period.
constexpr std::int64_t kMostSimulated = 200'000;
/// What makes an answer invalid costs more than any that holds.
constexpr double kInvalid = 1e18;
/// Of what does not repeat, by how much: so that less is better even while much is accepted.
constexpr double kSteep = 1000;
/// Of who preempts; then everybody pays.
constexpr int kGuesses = 4;
/// How much longer jobs may be taken for on an XPU that several clocks use.
constexpr double kStretches[] = {1, 1.15, 1.3, 1.5, 1.75, 2, 2.5, 3, 4, 6, 9, 14, 20};

struct State {
  std::vector<int> xpu;              ///< [xnode]
  std::vector<double> order;         ///< [xnode] us after its release; the smaller goes first
  std::vector<std::size_t> stretch;  ///< [xpu] index into kStretches
};

/// Components that are simulated together.
struct Part {
  std::vector<int> components;
  std::int64_t hyper = 0;   ///< ticks
  std::int64_t rounds = 0;  ///< hyperperiods to simulate
};

class Annealer {
 public:
  Annealer(const AppSpec& app, const Platform& platform, std::uint64_t seed)
      : app_(app),
        platform_(platform),
        found_(find_components(app).value()),
        random_(seed),
        pred_(app.xnodes.size()),
        succ_(app.xnodes.size()),
        mates_(app.xnodes.size()),
        in_flight_(app.xnodes.size(), 1),
        entry_(app.xnodes.size(), 1),
        before_(app.xnodes.size(), std::vector<char>(app.xnodes.size(), 0)),
        app_hash_(app.hash()) {
    for (std::size_t e = 0; e < app.edges.size(); ++e) {
      pred_[at(app.edges[e].second)].push_back(static_cast<int>(e));
      succ_[at(app.edges[e].first)].push_back(static_cast<int>(e));
    }
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      for (std::size_t x = 0; x < app.xnodes.size(); ++x)
        if (app.xnodes[x].module == app.xnodes[i].module) mates_[i].push_back(static_cast<int>(x));
      for (const ModuleSpec& m : app.modules)
        if (m.name == app.xnodes[i].module) in_flight_[i] = m.max_in_flight;
      for (const int e : pred_[i])
        if (app.xnodes[at(app.edges[at(e)].first)].module == app.xnodes[i].module) entry_[i] = 0;
    }
    const std::vector<int> order = app.topological_order();
    for (auto x = order.rbegin(); x != order.rend(); ++x)
      for (const int e : succ_[at(*x)]) {
        const int v = app.edges[at(e)].second;
        before_[at(*x)][at(v)] = 1;
        for (std::size_t y = 0; y < order.size(); ++y)
          if (before_[at(v)][y] != 0) before_[at(*x)][y] = 1;
      }
    split();
  }

  Annealed go(double time_limit_s) {
    const double began = 1e-9 * static_cast<double>(now_ns());
    Annealed best;
    double best_cost = kInvalid;
    State now = begin();
    double now_cost = evaluate(now);
    const auto keep = [&] {
      ++best.evaluations;
      if (last_cost_ >= best_cost || last_cost_ >= kInvalid) return;
      if (!best.policy) best.first_ms = 1000 * (1e-9 * static_cast<double>(now_ns()) - began);
      best_cost = last_cost_;
      best.policy = policy_;
    };
    keep();
    for (double passed = 0;
         (passed = (1e-9 * static_cast<double>(now_ns()) - began) / time_limit_s) < 1;) {
      State next = now;
      change(next);
      const double cost = evaluate(next);
      keep();
      const double temperature = 0.15 * std::pow(0.01, passed);
      if (cost <= now_cost * (1 - temperature * std::log(random_.unit()))) {
        now = std::move(next);
        now_cost = cost;
      }
    }
    return best;
  }

 private:
  using Ticks = std::int64_t;
  [[nodiscard]] std::size_t pick(std::size_t count) {
    return static_cast<std::size_t>(random_.below(count));
  }
  [[nodiscard]] const Component& home(int i) const {
    return found_.components[at(found_.of[at(i)])];
  }
  [[nodiscard]] double period_us(int i) const {
    return static_cast<double>(home(i).period_ticks) / static_cast<double>(found_.ticks_per_us);
  }
  [[nodiscard]] std::int64_t wcet(int i, int xpu) const {
    return *app_.xnodes[at(i)].wcet_on(platform_.xpus[at(xpu)].type);
  }
  [[nodiscard]] std::vector<int> may_run(int i) const {
    std::vector<int> list;
    for (std::size_t x = 0; x < platform_.xpus.size(); ++x)
      if (app_.xnodes[at(i)].wcet_on(platform_.xpus[x].type)) list.push_back(static_cast<int>(x));
    return list;
  }

  static std::int64_t rounds(std::int64_t jobs) { return std::max(kRounds, kJobs / jobs); }

  void split() {
    for (const Domain& domain : found_.domains) {
      if (domain.hyperperiod_ticks && domain.jobs > 0 && domain.jobs * kRounds <= kMostSimulated) {
        parts_.push_back({domain.components, *domain.hyperperiod_ticks, rounds(domain.jobs)});
        continue;
      }
      for (const int c : domain.components)
        parts_.push_back(
            {{c},
             found_.components[at(c)].period_ticks,
             rounds(static_cast<std::int64_t>(found_.components[at(c)].xnodes.size()))});
    }
  }

  /// Everybody where the load is then least; urgent is what has the least time behind it.
  State begin() {
    State s;
    s.xpu.assign(app_.xnodes.size(), -1);
    s.order.assign(app_.xnodes.size(), 0);
    s.stretch.assign(platform_.xpus.size(), 0);
    std::vector<double> load(platform_.xpus.size(), 0);
    std::vector<int> clock_of(platform_.xpus.size(), -1);
    for (const int i : app_.topological_order()) {
      double least = 1e300;
      for (const int x : may_run(i)) {
        // Better alone than beside another clock.
        const int clock = clock_of[at(x)];
        const double would = load[at(x)] + static_cast<double>(wcet(i, x)) / period_us(i) +
                             (clock >= 0 && clock != home(i).clock ? 0.5 : 0);
        if (would < least) least = would, s.xpu[at(i)] = x;
      }
      const int x = s.xpu[at(i)];
      clock_of[at(x)] = home(i).clock;
      load[at(x)] += static_cast<double>(wcet(i, x)) / period_us(i);
      double ready = 0;
      for (const int e : pred_[at(i)])
        ready = std::max(ready, s.order[at(app_.edges[at(e)].first)]);
      s.order[at(i)] = ready + static_cast<double>(wcet(i, s.xpu[at(i)]));
    }
    if (parts_.size() > 1)
      for (std::size_t x = 0; x < s.stretch.size(); ++x)
        while (s.stretch[x] + 1 < std::size(kStretches) &&
               kStretches[s.stretch[x]] * (1 - load[x] / 2) < 1)
          ++s.stretch[x];
    return s;
  }

  void change(State& s) {
    const auto i = static_cast<int>(pick(app_.xnodes.size()));
    const std::size_t what = pick(parts_.size() > 1 ? 10 : 8);
    if (what < 3) {
      const std::vector<int> list = may_run(i);
      s.xpu[at(i)] = list[pick(list.size())];
    } else if (what < 8) {
      s.order[at(i)] += (random_.unit() - 0.5) * period_us(i);
    } else {
      std::size_t& stretch = s.stretch[pick(s.stretch.size())];
      if (pick(2) == 0)
        stretch = std::min(stretch + 1, std::size(kStretches) - 1);
      else if (stretch > 0)
        --stretch;
    }
  }

  /// Where the windows of several clocks do not fit beside each other, wider ones may.
  double evaluate(State& s) {
    evaluate_once(s);
    for (int more = 0; more < 20 && tight_ >= 0 && parts_.size() > 1; ++more) {
      std::size_t& stretch = s.stretch[at(tight_)];
      if (stretch + 1 == std::size(kStretches)) break;
      ++stretch;
      evaluate_once(s);
    }
    return last_cost_;
  }

  /// Leaves the policy in policy_, and its cost in last_cost_.
  double evaluate_once(const State& s) {
    policy_ = Policy{app_.name, app_hash_, platform_.name, "annealer", {}, {}, 0};
    for (const ChainSpec& chain : app_.chains)
      policy_.chains.push_back({chain.name, kMaxTimeUs, 0, false});
    last_cost_ = kInvalid;
    tight_ = -1;
    // Who may preempt pays. That is known from the keys, so it is guessed, and guessed again.
    charged_.assign(s.xpu.size(), 0);
    for (int round = 0;; ++round) {
      if (round == kGuesses) charged_.assign(s.xpu.size(), 1);
      policy_.placements.clear();
      for (const int xpu : s.xpu) policy_.placements.push_back({xpu, {}});
      ready_by_.assign(s.xpu.size(), 0);
      growth_ = 0;
      for (const Part& part : parts_) simulate(part, s);
      if (growth_ > 0) return last_cost_ = kInvalid * (2 + kSteep * growth_);
      if (round == kGuesses || !charge(s)) break;
    }
    const auto report = solver::keys::check(app_, platform_, policy_);
    if (!report) {
      const std::string said = report.error().to_string();
      for (std::size_t x = 0; x < platform_.xpus.size(); ++x)
        if (said.find("XPU " + platform_.xpus[x].id + ",") != std::string::npos)
          tight_ = static_cast<int>(x);
      return last_cost_;
    }
    for (std::size_t c = 0; c < report->chains.size(); ++c)
      policy_.chains[c].worst_case_us = report->chains[c].derived_us;
    return last_cost_ = objective_of(app_, policy_);
  }

  /// True: somebody may preempt who has not paid, and now will. Job i may preempt j iff their
  /// releases may be so far apart that j is released before i is ready, and has the larger key.
  bool charge(const State& s) {
    bool more = false;
    const Ticks us = found_.ticks_per_us;
    for (std::size_t i = 0; i < s.xpu.size(); ++i) {
      if (charged_[i] != 0 || !platform_.xpus[at(s.xpu[i])].preemptive ||
          platform_.xpus[at(s.xpu[i])].preempt_us == 0)
        continue;
      const auto& keys = policy_.placements[i].key_us;
      const Ticks least = *std::min_element(keys.begin(), keys.end()) * us;
      for (std::size_t j = 0; j < s.xpu.size() && charged_[i] == 0; ++j) {
        if (j == i || s.xpu[j] != s.xpu[i]) continue;
        const auto& others = policy_.placements[j].key_us;
        const Ticks most = *std::max_element(others.begin(), others.end()) * us;
        const Component &a = home(static_cast<int>(i)), &b = home(static_cast<int>(j));
        bool may = least - most < ready_by_[i];  // at some real distance
        if (may && a.domain == b.domain) {
          const Ticks step = std::gcd(a.period_ticks, b.period_ticks);
          Ticks apart = (b.offset_ticks - a.offset_ticks) % step;
          apart += ((least - most - apart) / step - 1) * step;
          while (apart <= least - most || (apart == 0 && found_.of[i] == found_.of[j] &&
                                           (before_[i][j] != 0 || before_[j][i] != 0)))
            apart += step;
          may = apart < ready_by_[i];
        }
        if (may) charged_[i] = 1, more = true;
      }
    }
    return more;
  }

  struct Job {
    int xnode = 0;
    std::int64_t n = 0;
    Ticks key = 0, left = 0, release = 0;
    int waits = 0;
  };
  struct Event {
    Ticks when = 0;
    int job = 0, kind = 0;  ///< kind 0: it has run; 1: it is done for others; 2: one wait less
    std::int64_t stamp = 0;
    bool operator>(const Event& o) const { return when != o.when ? when > o.when : kind > o.kind; }
  };

  /// The ends of one clock's jobs, all as long as they may be, as keys. Where they are later from one
  /// hyperperiod to the next, that in periods goes into growth_.
  void simulate(const Part& part, const State& s) {
    std::vector<int> first(app_.xnodes.size(), -1);
    std::vector<std::int64_t> count(app_.xnodes.size(), 0);
    std::vector<Job> jobs;
    std::priority_queue<Event, std::vector<Event>, std::greater<>> events;
    const Ticks us = found_.ticks_per_us;
    // Where nobody is suspended: the longest of the others may be in the way.
    std::vector<std::int64_t> longest(s.xpu.size(), 0);
    for (std::size_t i = 0; i < s.xpu.size(); ++i)
      for (std::size_t j = 0; j < s.xpu.size(); ++j)
        if (i != j && s.xpu[i] == s.xpu[j] && !platform_.xpus[at(s.xpu[i])].preemptive)
          longest[i] = std::max(longest[i], wcet(static_cast<int>(j), s.xpu[j]));
    for (const int c : part.components)
      for (const int i : found_.components[at(c)].xnodes) {
        const Component& home_of = found_.components[at(c)];
        const Xpu& xpu = platform_.xpus[at(s.xpu[at(i)])];
        first[at(i)] = static_cast<int>(jobs.size());
        count[at(i)] = part.rounds * (part.hyper / home_of.period_ticks);
        const double work = static_cast<double>(wcet(i, s.xpu[at(i)]) +
                                                (charged_[at(i)] != 0 ? xpu.preempt_us : 0)) *
                            kStretches[s.stretch[at(s.xpu[at(i)])]];
        for (std::int64_t n = 0; n < count[at(i)]; ++n) {
          Job job{i, n, 0, static_cast<Ticks>(std::ceil(work)) * us, 0, 0};
          job.release = home_of.offset_ticks + n * home_of.period_ticks;
          job.key = job.release + static_cast<Ticks>(s.order[at(i)]) * us;
          job.waits = 1 + static_cast<int>(pred_[at(i)].size());
          if (entry_[at(i)] && n >= in_flight_[at(i)])
            job.waits += static_cast<int>(mates_[at(i)].size());
          Ticks arrives = job.release;
          for (const int source : app_.xnodes[at(i)].sources) {
            const SourceSpec& spec = app_.sources[at(source)];
            arrives = std::max(
                arrives, job.release + (spec.offset_us - home_of.offset_us + spec.jitter_us) * us);
          }
          events.push({arrives, static_cast<int>(jobs.size()), 2, 0});
          jobs.push_back(job);
        }
      }
    const std::size_t xpus = platform_.xpus.size();
    std::vector<std::priority_queue<std::pair<Ticks, int>, std::vector<std::pair<Ticks, int>>,
                                    std::greater<>>>
        ready(xpus);
    std::vector<int> running(xpus, -1);
    std::vector<Ticks> since(xpus, 0), done(jobs.size(), -1);
    std::vector<std::int64_t> stamp(xpus, 0);
    Ticks now = 0;
    const auto less = [&](int job) {
      if (--jobs[at(job)].waits > 0) return;
      const int xnode = jobs[at(job)].xnode;
      ready[at(s.xpu[at(xnode)])].push({jobs[at(job)].key, job});
      ready_by_[at(xnode)] = std::max(ready_by_[at(xnode)], now - jobs[at(job)].release);
    };
    while (!events.empty()) {
      now = events.top().when;
      while (!events.empty() && events.top().when == now) {
        const Event e = events.top();
        events.pop();
        const Job& job = jobs[at(e.job)];
        const std::size_t x = at(s.xpu[at(job.xnode)]);
        if (e.kind == 2) {
          less(e.job);
        } else if (e.kind == 0) {
          if (running[x] != e.job || stamp[x] != e.stamp) continue;
          running[x] = -1;
          // What others hear of is a whole microsecond after the release. A clock may be fast, and
          // an XPU that does not preempt may have begun the longest of the others.
          const std::int64_t ppm = app_.clocks[at(home(job.xnode).clock)].ppm;
          std::int64_t after = (now - job.release + us - 1) / us;
          after += longest[at(job.xnode)];
          if (ppm > 0) after += 1 + 4 * after * ppm / kMillion;
          events.push({job.release + after * us, e.job, 1, 0});
        } else {
          done[at(e.job)] = now;
          for (const int edge : succ_[at(job.xnode)]) {
            const int v = app_.edges[at(edge)].second;
            const Ticks later = now + transfer(edge, s) * us;
            const int next = first[at(v)] + static_cast<int>(job.n);
            events.push({later, next, 2, 0});
          }
          for (const int mate : mates_[at(job.xnode)])
            if (entry_[at(mate)] && job.n + in_flight_[at(mate)] < count[at(mate)])
              less(first[at(mate)] + static_cast<int>(job.n + in_flight_[at(mate)]));
        }
      }
      for (std::size_t x = 0; x < xpus; ++x) {
        if (ready[x].empty()) continue;
        if (running[x] >= 0) {
          if (ready[x].top().first >= jobs[at(running[x])].key) continue;
          jobs[at(running[x])].left -= now - since[x];
          ready[x].push({jobs[at(running[x])].key, running[x]});
        }
        running[x] = ready[x].top().second;
        ready[x].pop();
        since[x] = now;
        events.push({now + jobs[at(running[x])].left, running[x], 0, ++stamp[x]});
      }
    }
    for (const int c : part.components)
      for (const int i : found_.components[at(c)].xnodes) {
        const std::int64_t q = count[at(i)] / part.rounds;
        std::vector<std::int64_t>& keys = policy_.placements[at(i)].key_us;
        for (std::int64_t n = 0; n < q; ++n) {
          const std::size_t last = at(first[at(i)]) +
                                   static_cast<std::size_t>(n + part.rounds * 2 / 3 * q),
                            before = last - static_cast<std::size_t>(q);
          const Ticks later =
              (done[last] - jobs[last].release) - (done[before] - jobs[before].release);
          growth_ += static_cast<double>(std::abs(later)) /
                     static_cast<double>(found_.components[at(c)].period_ticks);
          keys.push_back((done[last] - jobs[last].release) / us);
        }
      }
  }

  [[nodiscard]] std::int64_t transfer(int edge, const State& s) const {
    const auto& [u, v] = app_.edges[at(edge)];
    for (const TransferSpec& t : app_.transfers)
      if (t.edge == edge && t.from_type == platform_.xpus[at(s.xpu[at(u)])].type &&
          t.to_type == platform_.xpus[at(s.xpu[at(v)])].type)
        return t.transfer_us;
    return 0;
  }

  static constexpr std::int64_t kMillion = 1'000'000;
  const AppSpec& app_;
  const Platform& platform_;
  const Components found_;
  solver::Random random_;
  std::vector<std::vector<int>> pred_, succ_;  ///< [xnode] edges
  std::vector<std::vector<int>> mates_;        ///< [xnode] of its module, itself among them
  std::vector<std::int64_t> in_flight_;        ///< [xnode] of its module
  std::vector<char> entry_;
  std::vector<std::vector<char>> before_;  ///< [xnode][xnode] by edges
  std::vector<Part> parts_;
  const std::string app_hash_;
  std::vector<char> charged_;    ///< [xnode] pays for a preemption
  std::vector<Ticks> ready_by_;  ///< [xnode] at the latest, after the release
  Policy policy_;
  double last_cost_ = kInvalid;
  int tight_ = -1;     ///< XPU that the check refused; -1: none
  double growth_ = 0;  ///< of the last schedule: 0: it repeats
};

}  // namespace

Annealed anneal(const AppSpec& app, const Platform& platform, double time_limit_s,
                std::uint64_t seed) {
  return Annealer(app, platform, seed).go(time_limit_s);
}

double objective_of(const AppSpec& app, const std::vector<std::int64_t>& chain_us) {
  const solver::keys::Totals totals = solver::keys::totals_of(app, chain_us);
  return app.has_deadlines() ? totals.largest : totals.sum;
}

double objective_of(const AppSpec& app, const Policy& policy) {
  return objective_of(app, worst_cases(policy));
}

}  // namespace xauto::bench

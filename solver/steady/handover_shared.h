// SPDX-License-Identifier: Apache-2.0
// A change of tables where clocks share XPUs: docs/steady-state.md, theorem 10, whose words these are.
// handover.cc alone reads it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "solver/steady/certificate.h"
#include "solver/steady/handover.h"
#include "solver/steady/handover_walk.h"

namespace xauto::solver::steady::handover {

/// Pairs (x, y) that are looked at, of all S together, beyond which nothing is claimed.
inline constexpr std::int64_t kMostPairs = 400'000'000;

/// From this key on jobs may be late by so much, in real time.
struct Rise {
  Tick key = 0, by = 0;
};

/// The jobs of one clock around one S.
struct LateAround {
  Tick s = 0;
  Tick since = 0;           ///< t_lo
  std::vector<Rise> rises;  ///< by key; `by` rises, too
  [[nodiscard]] Tick at_key(Tick key) const {
    const auto next = std::upper_bound(rises.begin(), rises.end(), key,
                                       [](Tick k, const Rise& r) { return k < r.key; });
    return next == rises.begin() ? 0 : (next - 1)->by;
  }
};

/// Of one clock of a cluster.
struct Lateness {
  std::vector<LateAround> around;  ///< each S of a hyperperiod
  Tick most = 0;                   ///< the largest
  Tick rises_until = 0;            ///< after the release before S, in real time
};

/// Clocks that share XPUs, directly or through others.
class Cluster {
 public:
  Cluster(const HandoverInput& in, std::vector<int> domains)
      : in_(in), p_(in.now), domains_(std::move(domains)), of_domain_(p_.domains.size()) {}

  /// Why nothing follows; empty: lateness() and settles() are there. Takes of `pairs`.
  std::string derive(std::int64_t& pairs, const Until& until) {
    if (std::string why = find_kinds(); !why.empty()) return why;
    if (!find_slack())
      return "XPUs that clocks share have no slack in one of the tables, in which a delay would "
             "end";
    Tick last = 0;
    for (const int d : domains_) {
      for (const int i : p_.domains[at(d)].xnodes)
        for (int n = 0; n < p_.jobs[at(i)]; ++n)
          last_a_ = std::max(last_a_, in_.from.a[p_.slot_of(i, n)]);
    }
    for (const int d : domains_) {
      if (std::string why = derive(d, pairs, until); !why.empty()) return why;
      most_ += of_domain_[at(d)].most;
      last = std::max(last, of_domain_[at(d)].rises_until);
    }
    settles_ = std::max(last, last_a_) + (most_ * 100 + slack_pct_ - 1) / slack_pct_;
    return {};
  }
  [[nodiscard]] const Lateness& lateness(int domain) const { return of_domain_[at(domain)]; }
  /// Of the other clocks, together.
  [[nodiscard]] Tick most_of_others(int domain) const {
    return most_ - of_domain_[at(domain)].most;
  }
  /// After S, in real time.
  [[nodiscard]] Tick settles() const { return settles_; }

 private:
  struct Job {
    Tick ready, key, work;  ///< alpha, late; the key, early
  };
  /// `value` from `length` on.
  struct Step {
    Tick length, value;
  };
  /// x from `low` to `end`, y up to `high`.
  struct Range {
    Tick low, end, high;
  };
  enum class Kind : std::uint8_t { kUnused, kAlone, kLikeFrom, kLikeTo };

  [[nodiscard]] std::string clock_of(int domain) const {
    return "clock '" + p_.clock_name[at(p_.domains[at(domain)].clock)] + "' ";
  }
  [[nodiscard]] Tick cost_of(const Problem& p, int xnode, int xpu) const {
    return p.wcet(xnode, xpu) + p_.preempt[at(xpu)];
  }
  /// W of a clock on an XPU.
  [[nodiscard]] Tick work_of(int domain, int xpu, bool second) const {
    Tick work = 0;
    for (const int i : p_.domains[at(domain)].xnodes)
      if ((second ? in_.to_xpu : in_.from_xpu)[at(i)] == xpu)
        work += p_.jobs[at(i)] * cost_of(second ? in_.then : in_.now, i, xpu);
    return work;
  }

  std::string find_kinds() {
    kinds_.assign(at(p_.num_xpus), Kind::kUnused);
    for (int m = 0; m < p_.num_xpus; ++m) {
      int users = 0;
      bool more = true, less = true;
      for (const int d : domains_) {
        const Tick before = work_of(d, m, false), after = work_of(d, m, true);
        users += before > 0 || after > 0;
        more = more && after >= before;
        less = less && after <= before;
      }
      if (users == 0) continue;
      if (p_.preemptive[at(m)] == 0)
        return p_.xpu_name[at(m)] + " is not preemptive, and is of clocks that share XPUs";
      if (users > 1 && !more && !less)
        return p_.xpu_name[at(m)] + " has more work of one clock, and less of another one";
      kinds_[at(m)] = users == 1 ? Kind::kAlone : more ? Kind::kLikeTo : Kind::kLikeFrom;
    }
    return {};
  }

  /// Both tables with so much slack, as if each job paid for a preemption.
  bool find_slack() {
    for (const int pct : {8, 5, 3, 2, 1}) {
      const auto passes = [&](const Problem& of, const std::vector<int>& xpu, Windows w) {
        Problem p = of;
        for (int i = 0; i < p.num_xnodes; ++i)
          for (int m = 0; m < p.num_xpus; ++m)
            if (Tick& c = p.wcet_flat[at(i) * at(p.num_xpus) + at(m)]; c != kNoTick)
              c = ((c + p.preempt[at(m)]) * 100 + (100 - pct) - 1) / (100 - pct);
        std::fill(p.preempt.begin(), p.preempt.end(), 0);
        return certify(p, xpu, w);
      };
      if (!passes(in_.now, in_.from_xpu, in_.from) || !passes(in_.then, in_.to_xpu, in_.to))
        continue;
      slack_pct_ = pct;
      return true;
    }
    return false;
  }

  std::string derive(int d, std::int64_t& pairs, const Until& until) {
    const Domain& domain = p_.domains[at(d)];
    const std::int64_t ppm = domain.ppm;
    Lateness& lateness = of_domain_[at(d)];
    Tick deepest = 0;
    for (const int i : domain.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n)
        deepest = std::max({deepest, in_.from.d[p_.slot_of(i, n)], in_.to.d[p_.slot_of(i, n)]});
    const Tick blur = lost_in(deepest, ppm), reach = deepest + 2 * blur;
    const Tick last_a = last_a_ + lost_in(last_a_, ppm);
    std::vector<Tick> all;
    for (const int c : domain.components)
      for (int n = 0; n < p_.components[at(c)].jobs; ++n)
        all.push_back((p_.components[at(c)].phase + n * p_.components[at(c)].period) %
                      domain.hyper);
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    const Tick before_most = reach + 2 * domain.hyper + 2 * blur,
               after_most = reach + last_a + 2 * domain.hyper + 2 * blur;
    std::vector<std::vector<Step>> due(at(p_.num_xpus));
    const Tick notice = in_fast_time(in_.notice, ppm);
    Tick gap = 0;
    for (std::size_t r = 0; r < all.size(); ++r)
      gap = std::max(gap, all[r] - (r > 0 ? all[r - 1] : all.back() - domain.hyper));
    for (int m = 0; m < p_.num_xpus; ++m)
      if (kinds_[at(m)] == Kind::kLikeFrom || kinds_[at(m)] == Kind::kLikeTo)
        if (!dbf(d, m, deepest, before_most + gap + notice + after_most, pairs, due[at(m)]))
          return clock_of(d) + "takes more jobs than are looked at";
    for (std::size_t r = 0; r < all.size(); ++r) {
      const Tick last = r > 0 ? all[r - 1] : all.back() - domain.hyper;
      LateAround around{all[r], last - notice, {}};
      std::vector<std::vector<Job>> jobs(at(p_.num_xpus));
      const Range look{around.since - before_most, all[r] + last_a, all[r] + after_most};
      if (!list(d, around, look, jobs))
        return clock_of(d) + "has jobs that wait for the other table until after their keys";
      rise(around, look, 2 * blur, ppm, due, jobs, pairs);
      if (pairs < 0 || until.over()) return clock_of(d) + "takes more jobs than are looked at";
      if (!around.rises.empty()) {
        lateness.most = std::max(lateness.most, around.rises.back().by);
        lateness.rises_until =
            std::max(lateness.rises_until, in_slow_time(around.rises.back().key - last, ppm));
      }
      lateness.around.push_back(std::move(around));
    }
    return {};
  }

  /// The demand bound of a clock on a shared XPU, with each job's cost, no drift. False: too many.
  bool dbf(int d, int m, Tick deepest, Tick longest, std::int64_t& pairs,
           std::vector<Step>& steps) const {
    const bool second = kinds_[at(m)] == Kind::kLikeTo;
    const Domain& domain = p_.domains[at(d)];
    const Windows& w = second ? in_.to : in_.from;
    std::vector<Job> jobs;
    for (const int i : domain.xnodes) {
      if ((second ? in_.to_xpu : in_.from_xpu)[at(i)] != m) continue;
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      const Tick work = cost_of(second ? in_.then : in_.now, i, m);
      for (std::int64_t n = floor_div(-deepest - c.phase, c.period);
           c.phase + n * c.period < domain.hyper + longest; ++n) {
        const std::size_t slot = p_.slot_of(i, n);
        const Tick release = c.phase + n * c.period;
        jobs.push_back({release + w.a[slot], release + w.d[slot], work});
      }
      if (jobs.size() > 200'000) return false;
    }
    std::sort(jobs.begin(), jobs.end(), [](const Job& a, const Job& b) { return a.key < b.key; });
    for (const Job& first : jobs) {
      // One hyperperiod of begins, each with all that comes before it.
      if (first.ready < 0 || first.ready >= domain.hyper) continue;
      Tick sum = 0;
      for (const Job& job : jobs) {
        if (--pairs < 0) return false;
        if (job.key > first.ready + longest) break;
        if (job.ready < first.ready) continue;
        sum += job.work;
        steps.push_back({job.key - first.ready, sum});
      }
    }
    std::sort(steps.begin(), steps.end(), [](const Step& a, const Step& b) {
      return a.length != b.length ? a.length < b.length : a.value > b.value;
    });
    std::size_t kept = 0;
    for (const Step& s : steps)
      if (kept == 0 || s.value > steps[kept - 1].value) steps[kept++] = s;
    steps.resize(kept);
    return true;
  }

  /// All jobs that matter, by XPU. False: one is ready after its key.
  bool list(int d, const LateAround& around, const Range& look,
            std::vector<std::vector<Job>>& jobs) const {
    const Domain& domain = p_.domains[at(d)];
    const auto blur = [&](Tick t) { return lost_in(t, domain.ppm); };
    for (const int i : domain.xnodes) {
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      const auto release = [&](std::int64_t n) { return c.phase + n * c.period; };
      const std::int64_t first = floor_div(around.s - 1 - c.phase, c.period) + 1;
      const auto late_key = [&](int xnode, std::int64_t n) {  // of the first table
        const Tick key = in_.from.d[p_.slot_of(xnode, n)];
        return release(n) + key + blur(key);
      };
      Tick before = 0;  // alpha of the activation before
      std::int64_t n = first;
      while (late_key(i, n - 1) >= look.low) --n;
      for (bool any = false; release(n) <= look.high; ++n) {
        const bool second = n >= first;
        const Windows& w = second ? in_.to : in_.from;
        const int m = (second ? in_.to_xpu : in_.from_xpu)[at(i)];
        const std::size_t slot = p_.slot_of(i, n);
        Tick ready = release(n) + w.a[slot] + blur(w.a[slot]);
        const Tick key = release(n) + w.d[slot] - blur(w.d[slot]);
        if (second && any) ready = std::max(ready, before);
        if (n == first) {
          const Tick last = late_key(i, n - 1);
          if (m != in_.from_xpu[at(i)] || last > key) ready = std::max(ready, last);
        }
        const int module = p_.module_of[at(i)];
        if (second && module >= 0 && p_.entry[at(i)] != 0) {
          const Module& of = p_.modules[at(module)];
          if (of.in_flight < kMillion && n - of.in_flight < first)
            for (const int u : of.xnodes) ready = std::max(ready, late_key(u, n - of.in_flight));
        }
        if (ready >= key) return false;
        before = ready;
        any = true;
        const bool grown = !second && late_key(i, n) >= around.since;
        const Problem& of = second ? in_.then : grown ? in_.both : in_.now;
        jobs[at(m)].push_back({ready, key, cost_of(of, i, m)});
      }
    }
    return true;
  }

  void rise(LateAround& around, const Range& look, Tick shorter, std::int64_t ppm,
            const std::vector<std::vector<Step>>& due, std::vector<std::vector<Job>>& jobs,
            std::int64_t& pairs) const {
    struct At {
      Tick key;
      int xpu;
    };
    std::vector<At> keys;
    for (int m = 0; m < p_.num_xpus; ++m) {
      std::sort(jobs[at(m)].begin(), jobs[at(m)].end(),
                [](const Job& a, const Job& b) { return a.ready > b.ready; });
      for (const Job& job : jobs[at(m)])
        if (job.key > around.since && job.key <= look.high) keys.push_back({job.key, m});
    }
    std::sort(keys.begin(), keys.end(), [](const At& a, const At& b) { return a.key < b.key; });
    for (const At& y : keys) {
      const std::vector<Step>& steps = due[at(y.xpu)];
      const bool alone = kinds_[at(y.xpu)] == Kind::kAlone;
      Tick sum = 0, most = around.rises.empty() ? 0 : around.rises.back().by;
      const Tick so_far = most;
      std::size_t step = 0;
      for (const Job& x : jobs[at(y.xpu)]) {
        if (x.ready >= y.key) continue;
        if (x.ready < look.low) break;
        if (--pairs < 0) return;
        if (x.key <= y.key) sum += x.work;
        if (x.ready >= look.end) continue;
        const Tick length = y.key - x.ready;
        Tick served = 0;
        if (alone) {
          served = std::max(Tick{0}, length - lost_in(length, ppm));
        } else {
          while (step < steps.size() && steps[step].length <= length - shorter) ++step;
          served = step == 0 ? 0 : steps[step - 1].value;
        }
        if (sum <= served) continue;
        most = std::max(most, around.at_key(x.ready) + sum - served);
      }
      if (most > so_far) around.rises.push_back({y.key, most});
    }
  }

  const HandoverInput& in_;
  const Problem& p_;
  const std::vector<int> domains_;
  std::vector<Kind> kinds_;  ///< [xpu]
  int slack_pct_ = 0;
  Tick last_a_ = 0;  ///< M, before it is taken late
  std::vector<Lateness> of_domain_;
  Tick most_ = 0, settles_ = 0;
};

/// What a walk tells of jobs (handover_walk.h), by theorem 10.
struct MaybeLate {
  const Problem& p;
  const Unchanged from, to;
  const LateAround& around;
  Tick others;  ///< lateness of other clocks
  [[nodiscard]] bool on_time(int xnode, std::int64_t n) const {
    return release(xnode, n) < around.s && from.ends(xnode, n) < around.since;
  }
  [[nodiscard]] const Unchanged& table(int xnode, std::int64_t n) const {
    return release(xnode, n) < around.s ? from : to;
  }
  [[nodiscard]] Tick release(int xnode, std::int64_t n) const { return from.release(xnode, n); }
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const {
    const Tick key = table(xnode, n).ends(xnode, n);
    if (on_time(xnode, n)) return key;
    return key + in_fast_time(around.at_key(key) + others, from.ppm);
  }
  [[nodiscard]] Tick held(int xnode, std::int64_t n) const {
    return table(xnode, n).held(xnode, n);
  }
  [[nodiscard]] std::optional<Tick> key(int xnode, std::int64_t n) const {
    if (!on_time(xnode, n)) return std::nullopt;
    return from.key(xnode, n);
  }
  [[nodiscard]] Tick hold(int xnode, std::int64_t n) const {
    return table(xnode, n).hold(xnode, n);
  }
  [[nodiscard]] Tick most_hold(int xnode) const {
    return std::max(from.most_hold(xnode), to.most_hold(xnode));
  }
};

}  // namespace xauto::solver::steady::handover

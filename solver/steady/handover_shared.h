// SPDX-License-Identifier: Apache-2.0
// A change of tables where clocks share XPUs: docs/steady-state.md, theorem 10, whose words these are.
// handover.cc alone reads it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "solver/steady/certificate.h"
#include "solver/steady/demand.h"
#include "solver/steady/handover.h"
#include "solver/steady/handover_walk.h"

namespace xauto::solver::steady::handover {

/// Pairs (x, y) that are looked at, of all S together, beyond which nothing is claimed.
inline constexpr std::int64_t kMostPairs = 400'000'000;

/// From this key on jobs may be late by so much, in real time.
struct Rise {
  Tick key = 0, by = 0;
};

/// By key; `by` rises, too.
using Rises = std::vector<Rise>;
[[nodiscard]] inline Tick late_at(const Rises& rises, Tick key) {
  const auto next = std::upper_bound(rises.begin(), rises.end(), key,
                                     [](Tick k, const Rise& r) { return k < r.key; });
  return next == rises.begin() ? 0 : (next - 1)->by;
}

/// A job of the second table that may be ready later than its `a`, since it waits for the first one.
struct Raised {
  int xnode = 0;
  std::int64_t n = 0;
  Tick ready = 0;      ///< alpha
  Tick due = kNoTick;  ///< where that is after its key
  bool operator<(const Raised& o) const { return std::tie(xnode, n) < std::tie(o.xnode, o.n); }
};

/// The jobs of one clock around one S.
struct LateAround {
  Tick s = 0;
  Tick since = 0;   ///< t_lo
  Tick waited = 0;  ///< by then all that wait for the first table are ready, and have their dues
  std::vector<Raised> raised;  ///< in order
  std::vector<Rises> rises;    ///< [set of XPUs]
  [[nodiscard]] const Raised* find(int xnode, std::int64_t n) const {
    const auto found = std::lower_bound(raised.begin(), raised.end(), Raised{xnode, n});
    return found != raised.end() && found->xnode == xnode && found->n == n ? &*found : nullptr;
  }
  [[nodiscard]] Tick last_rise() const {
    Tick last = s;
    for (const Rises& of : rises)
      if (!of.empty()) last = std::max(last, of.back().key);
    for (const Raised& job : raised) last = std::max(last, job.due);
    return last;
  }
};

/// Of one clock of a cluster.
struct Lateness {
  std::vector<LateAround> around;  ///< each S of a hyperperiod
  std::vector<Tick> most;          ///< [set of XPUs] the largest
  std::vector<__int128> line;      ///< [set of XPUs] see Cluster::rise
};

/// Clocks that share XPUs, directly or through others.
class Cluster {
 public:
  Cluster(const HandoverInput& in, std::vector<int> domains)
      : in_(in), p_(in.now), domains_(std::move(domains)), of_domain_(p_.domains.size()) {}

  /// Why nothing follows; empty: lateness() and settles() are there. Takes of `pairs`.
  std::string derive(std::int64_t& pairs, const Until& until) {
    find_kinds();
    find_sets();
    for (const int d : domains_)
      if (std::string why = find_raised(d, pairs); !why.empty()) return why;
    // Nobody waits for the first table then, whatever the clock has done.
    if (blocks_) last_ready_ += shift_;
    std::string why = derive_late(pairs, until);
    if (!why.empty() || !blocks_ || slack_pct_ == kLeastSlackPct) return why;
    // With the largest slack lateness falls soonest; with the least one G, and so λ, is least. Both hold.
    const std::vector<Lateness> with_most = of_domain_;
    const std::vector<Tick> most = most_;
    const Tick settles = settles_;
    std::int64_t left = pairs;
    slack_pct_ = kLeastSlackPct;
    lets_in_.assign(at(p_.num_xpus), 0);
    if (derive_late(left, until).empty()) {
      settles_ = std::min(settles, settles_);
      pairs = left;
    } else {
      of_domain_ = with_most;
      most_ = most;
      settles_ = settles;
    }
    return why;
  }
  [[nodiscard]] const Lateness& lateness(int domain) const { return of_domain_[at(domain)]; }
  /// Of the other clocks, together.
  [[nodiscard]] Tick most_of_others(int domain, std::size_t set) const {
    return most_[set] - of_domain_[at(domain)].most[set];
  }
  /// R(m), by number.
  [[nodiscard]] std::size_t set_of(int xpu) const { return set_of_[at(xpu)]; }
  /// After S, in real time.
  [[nodiscard]] Tick settles() const { return settles_; }

 private:
  /// So often L is raised, beyond which nothing is claimed.
  static constexpr int kMostRounds = 8;
  static constexpr int kLeastSlackPct = 1;
  /// Slacks that are tried: with more of it lateness falls sooner. Chosen; the checker has the same.
  static constexpr int kSlacksPct[] = {8, 5, 3, 2, kLeastSlackPct};

  /// λ and settles(), with the largest slack that is left, of those up to slack_pct_ if that is set. Why
  /// nothing follows; empty: it does.
  std::string derive_late(std::int64_t& pairs, const Until& until) {
    for (int round = 0; round < kMostRounds; ++round) {
      if (std::string why = find_dues(pairs); !why.empty()) return why;
      if (!find_slack(pairs))
        return round == 0 ? "clocks share XPUs, and one of the tables leaves less than 1 % of one"
                          : "clocks share XPUs, one of which does not preempt, and who is late "
                            "lets others in before it";
      find_slope();
      if (std::string why = find_late(pairs, until); !why.empty()) return why;
      if (!let_in_more()) return {};
    }
    return "clocks share XPUs, one of which does not preempt, and who is late lets in more and "
           "more";
  }

  struct Job {
    int xnode;
    std::int64_t n;
    Tick ready, key, work;  ///< alpha, late; the key, early
    Tick due;               ///< where it is after the key
    Tick starts, late_key;  ///< release + e, early; the key, late
    Tick blocks;            ///< C, where it is in the way of a smaller key
  };
  /// y, of an XPU; where it is a due, of that job.
  struct At {
    Tick key;
    int xpu;
    const Job* due_of;
  };
  /// x from `low` to `end`, y up to `high`.
  struct Range {
    Tick low, end, high;
  };
  /// Of an XPU: how a clock's share there is found.
  enum class Kind : std::uint8_t { kUnused, kAlone, kLikeFrom, kLikeTo, kSplit };
  /// The demand bounds of a clock on one XPU, of both tables; where its share is by one of them, that one.
  struct Due {
    std::vector<Step> from, to;
  };

  [[nodiscard]] std::string clock_of(int domain) const {
    return "clock '" + p_.clock_name[at(p_.domains[at(domain)].clock)] + "' ";
  }
  [[nodiscard]] Tick preempt_of(int xpu) const {
    return p_.preemptive[at(xpu)] != 0 ? p_.preempt[at(xpu)] : 0;
  }
  [[nodiscard]] Tick cost_of(const Problem& p, int xnode, int xpu) const {
    return p.wcet(xnode, xpu) + preempt_of(xpu);
  }
  /// W of a clock on an XPU.
  [[nodiscard]] Tick work_of(int domain, int xpu, bool second) const {
    Tick work = 0;
    for (const int i : p_.domains[at(domain)].xnodes)
      if ((second ? in_.to_xpu : in_.from_xpu)[at(i)] == xpu)
        work += p_.jobs[at(i)] * cost_of(second ? in_.then : in_.now, i, xpu);
    return work;
  }

  /// lambda and all that comes of it, with L as it is.
  std::string find_late(std::int64_t& pairs, const Until& until) {
    most_.clear();
    settles_ = 0;
    for (const int d : domains_) {
      Lateness& of = of_domain_[at(d)];
      of.most.assign(sets_.size(), 0);
      of.line.assign(sets_.size(), 0);
      if (std::string why = derive(d, pairs, until); !why.empty()) return why;
    }
    for (std::size_t set = 0; set < sets_.size(); ++set) {
      Tick most = 0;
      for (const int d : domains_) most += of_domain_[at(d)].most[set];
      most_.push_back(most);
      __int128 last =
          static_cast<__int128>(last_ready_) * slope_.up + static_cast<__int128>(most) * slope_.of;
      for (const int d : domains_)
        last = std::max(last, of_domain_[at(d)].line[set] +
                                  static_cast<__int128>(most_of_others(d, set)) * slope_.of);
      settles_ = std::max(settles_, static_cast<Tick>((last + slope_.up - 1) / slope_.up));
    }
    return {};
  }
  /// Raises L where lateness is more than it says. False: nowhere.
  bool let_in_more() {
    bool more = false;
    for (int m = 0; m < p_.num_xpus; ++m) {
      if (kinds_[at(m)] == Kind::kUnused || p_.preemptive[at(m)] != 0) continue;
      for (int by = 0; by < p_.num_xpus; ++by) {
        if (feeds_[at(m)][at(by)] == 0 || kinds_[at(by)] == Kind::kUnused) continue;
        const Tick late = most_[set_of(by)];
        more = more || late > lets_in_[at(m)];
        lets_in_[at(m)] = std::max(lets_in_[at(m)], late);
      }
    }
    return more;
  }

  void find_kinds() {
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
      blocks_ = blocks_ || p_.preemptive[at(m)] == 0;
      kinds_[at(m)] = users == 1 ? Kind::kAlone
                      : more     ? Kind::kLikeTo
                      : less     ? Kind::kLikeFrom
                                 : Kind::kSplit;
    }
    lets_in_.assign(at(p_.num_xpus), 0);
    for (const int d : domains_)
      shift_ = std::max(shift_, in_slow_time(looks_at(d).shorter, p_.domains[at(d)].ppm));
  }

  /// work / (1 - pct %)
  [[nodiscard]] static Tick with_slack(Tick work, int pct) {
    return (work * 100 + (100 - pct) - 1) / (100 - pct);
  }

  /// Both tables with so much slack, as if each job paid for a preemption; and with what L lets in.
  bool find_slack(std::int64_t& pairs) {
    for (const int pct : kSlacksPct) {
      if (slack_pct_ > 0 && pct > slack_pct_) continue;
      const auto passes = [&](const Problem& of, const std::vector<int>& xpu, Windows w) {
        Problem p = of;
        for (int i = 0; i < p.num_xnodes; ++i)
          for (int m = 0; m < p.num_xpus; ++m)
            if (Tick& c = p.wcet_flat[at(i) * at(p.num_xpus) + at(m)]; c != kNoTick)
              c = with_slack(c + preempt_of(m), pct);
        std::fill(p.preempt.begin(), p.preempt.end(), 0);
        return certify(p, xpu, w);
      };
      // What has passed once passes again.
      if (pct != slack_pct_ &&
          (!passes(in_.now, in_.from_xpu, in_.from) || !passes(in_.then, in_.to_xpu, in_.to)))
        continue;
      if (!has_room(pct, pairs)) continue;
      slack_pct_ = pct;
      return true;
    }
    return false;
  }

  /// On all XPUs that do not preempt, for those that lateness lets in; finds what is lacking.
  bool has_room(int pct, std::int64_t& pairs) {
    lacks_.assign(at(p_.num_xpus), {});
    for (int m = 0; m < p_.num_xpus; ++m) {
      if (kinds_[at(m)] == Kind::kUnused || p_.preemptive[at(m)] != 0) continue;
      if (kinds_[at(m)] == Kind::kAlone ? !has_room_alone(m, pct, pairs)
                                        : !has_room_shared(m, pct, pairs))
        return false;
    }
    return true;
  }

  bool has_room_shared(int m, int pct, std::int64_t& pairs) {
    std::vector<Pattern> from, to;
    std::vector<Blocking> of_second, of_both;
    const Tick in = lets_in_[at(m)];
    for (const int d : domains_) {
      const int own = static_cast<int>(to.size());
      for (const bool second : {false, true})
        if (Pattern of = pattern_of(d, m, second, pct); !of.jobs.empty())
          (second ? to : from).push_back(std::move(of));
      for (const int i : p_.domains[at(d)].xnodes)
        for (const bool second : {false, true}) {
          if ((second ? in_.to_xpu : in_.from_xpu)[at(i)] != m) continue;
          const Windows& w = second ? in_.to : in_.from;
          Tick longest = 0, beside = 0;
          for (int n = 0; n < p_.jobs[at(i)]; ++n) {
            longest = std::max(longest, w.d[p_.slot_of(i, n)] - w.e[p_.slot_of(i, n)]);
            if (second) beside = std::max(beside, work_beside(i, n, in, pct, pairs));
          }
          const Tick work = with_slack((second ? in_.then : in_.both).wcet(i, m), pct);
          of_both.push_back({longest + in + shift_, work});
          if (second) of_second.push_back({longest + in, work, own, beside});
        }
    }
    if (pairs < 0 || (!to.empty() && !demand_fits(to, of_second))) return false;
    return lacks_[at(m)].from.find(from, of_both) && lacks_[at(m)].to.find(to, of_both);
  }

  /// W(z), of job n of `z` in the second table: what there may be of its clock between its start and its key
  /// if jobs may be ready `in` later than they should.
  [[nodiscard]] Tick work_beside(int z, std::int64_t n, Tick in, int pct,
                                 std::int64_t& pairs) const {
    const Windows& w = in_.to;
    const int m = in_.to_xpu[at(z)];
    const Domain& domain = p_.domains[at(p_.domain_of(z))];
    const auto release = [&](int i, std::int64_t k) {
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      return c.phase + k * c.period;
    };
    const Tick from = w.e[p_.slot_of(z, n)] - in, to = w.d[p_.slot_of(z, n)];
    const Tick begin = release(z, n);
    Tick sum = 0;
    for (const int i : domain.xnodes) {
      if (in_.to_xpu[at(i)] != m || i == z) continue;
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      const Tick work = with_slack(cost_of(in_.then, i, m), pct);
      Tick deepest = 0;
      for (int k = 0; k < p_.jobs[at(i)]; ++k) deepest = std::max(deepest, w.a[p_.slot_of(i, k)]);
      // The latest release that may count, and then back to the first one.
      for (std::int64_t k =
               floor_div(begin + to + 2 * lost_in(to, domain.ppm) - c.phase, c.period) + 1;
           --pairs >= 0; --k) {
        const Tick apart = release(i, k) - begin, error = lost_in(std::abs(apart), domain.ppm);
        const std::size_t slot = p_.slot_of(i, k);
        if (apart + error + deepest < from) break;
        if (apart + error + w.a[slot] < from) continue;
        if (apart - error + w.d[slot] >= to) continue;
        if (k <= n && p_.before(i, z)) continue;
        sum += work;
      }
    }
    return sum;
  }

  /// All jobs are of the second table, and in time.
  bool has_room_alone(int m, int pct, std::int64_t& pairs) const {
    const auto user = std::find_if(domains_.begin(), domains_.end(),
                                   [&](int d) { return work_of(d, m, true) > 0; });
    if (user == domains_.end()) return true;
    const Domain& domain = p_.domains[at(*user)];
    const std::int64_t ppm = domain.ppm;
    const Tick hyper = domain.hyper;
    if (work_of(*user, m, true) * 100 > (100 - pct) * (hyper - lost_in(hyper, ppm))) return false;
    const Looked looked = looks_at(*user);  // `before` is D + 2H + 2b + w(L)
    const Tick in = in_fast_time(lets_in_[at(m)], ppm);
    const Tick end = hyper + std::max(looked.before, in);
    std::vector<Job> jobs;
    for (const int i : domain.xnodes) {
      if (in_.to_xpu[at(i)] != m) continue;
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      for (std::int64_t n = floor_div(-looked.before - c.phase, c.period);
           c.phase + n * c.period <= end && --pairs >= 0; ++n)
        jobs.push_back(job_of(i, n, true, ppm));
    }
    std::sort(jobs.begin(), jobs.end(),
              [](const Job& a, const Job& b) { return a.ready > b.ready; });
    for (const Job& y : jobs) {
      const std::vector<Job> met = who_blocks(jobs, {y.key, m, nullptr}, in);
      Tick sum = 0;
      for (const Job& x : jobs) {
        if (x.key > y.key) continue;
        if (x.ready < 0) break;
        if (--pairs < 0) return false;
        sum += x.work;
        if (x.ready >= hyper || x.ready >= y.key || y.key - x.ready > looked.before) continue;
        const Tick length = y.key - x.ready;
        if ((sum + blocked(met, x.ready, y.key, in)) * 100 >
            (100 - pct) * std::max(Tick{0}, length - lost_in(length, ppm)))
          return false;
      }
    }
    return true;
  }

  /// As its table says.
  [[nodiscard]] Job job_of(int i, std::int64_t n, bool second, std::int64_t ppm) const {
    const Component& c = p_.components[at(p_.component_of[at(i)])];
    const Windows& w = second ? in_.to : in_.from;
    const int m = (second ? in_.to_xpu : in_.from_xpu)[at(i)];
    const std::size_t slot = p_.slot_of(i, n);
    const Tick release = c.phase + n * c.period;
    const auto blur = [&](Tick t) { return lost_in(t, ppm); };
    return {i,
            n,
            release + w.a[slot] + blur(w.a[slot]),
            release + w.d[slot] - blur(w.d[slot]),
            cost_of(second ? in_.then : in_.now, i, m),
            kNoTick,
            release + w.e[slot] - blur(w.e[slot]),
            release + w.d[slot] + blur(w.d[slot]),
            (second ? in_.then : in_.both).wcet(i, m)};
  }

  /// z cannot start before v has ended.
  [[nodiscard]] bool waits_for(const Job& z, const Job& v) const {
    if (p_.component_of[at(z.xnode)] != p_.component_of[at(v.xnode)]) return false;
    if (z.xnode == v.xnode) return z.n > v.n;
    if (z.n >= v.n && p_.before(v.xnode, z.xnode)) return true;
    const int module = p_.module_of[at(z.xnode)];
    return module >= 0 && module == p_.module_of[at(v.xnode)] &&
           z.n - v.n >= p_.modules[at(module)].in_flight;
  }
  /// Of an XPU of one clock: those that may be in the way of one that has to end by `y`, if jobs may be
  /// ready `in` later than they should.
  [[nodiscard]] std::vector<Job> who_blocks(const std::vector<Job>& jobs, const At& y,
                                            Tick in) const {
    std::vector<const Job*> ends;
    if (y.due_of != nullptr) {
      ends.push_back(y.due_of);
    } else {
      for (const Job& v : jobs)
        if (v.key <= y.key && v.late_key >= y.key) ends.push_back(&v);
    }
    std::vector<Job> met;
    for (const Job& z : jobs)
      if (z.late_key > (y.due_of != nullptr ? y.due_of->key : y.key) && z.starts < y.key + in &&
          std::any_of(ends.begin(), ends.end(), [&](const Job* v) {
            return (v->xnode != z.xnode || v->n != z.n) && !waits_for(z, *v);
          }))
        met.push_back(z);
    return met;
  }
  /// B(x, y)
  [[nodiscard]] static Tick blocked(const std::vector<Job>& met, Tick x, Tick y, Tick in) {
    Tick longest = 0;
    for (const Job& z : met)
      if (z.starts <= x + in && !(z.key <= y && z.ready >= x))
        longest = std::max(longest, z.blocks);
    return longest;
  }

  /// What a clock does on an XPU, with each job's cost, / (1 - pct %).
  [[nodiscard]] Pattern pattern_of(int d, int m, bool second, int pct) const {
    const Domain& domain = p_.domains[at(d)];
    const Windows& w = second ? in_.to : in_.from;
    Pattern pattern;
    pattern.period = domain.hyper;
    pattern.ppm = domain.ppm;
    for (const int i : domain.xnodes) {
      if ((second ? in_.to_xpu : in_.from_xpu)[at(i)] != m) continue;
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      const Tick work = with_slack(cost_of(second ? in_.then : in_.now, i, m), pct);
      for (std::int64_t n = 0; n < c.jobs; ++n) {
        const std::size_t slot = p_.slot_of(i, n);
        pattern.deepest = std::max(pattern.deepest, w.d[slot]);
        pattern.jobs.push_back(
            {(c.phase + n * c.period + w.a[slot]) % domain.hyper, w.d[slot] - w.a[slot], work});
      }
    }
    return pattern;
  }

  /// g of an XPU that clocks share and that does not preempt.
  [[nodiscard]] Tick lack(int m, Tick length) const {
    const Lacks& of = lacks_[at(m)];
    if (kinds_[at(m)] == Kind::kLikeTo) return of.to.from(length);
    if (kinds_[at(m)] == Kind::kLikeFrom) return of.from.from(length);
    return std::max(of.from.from(length / 2), of.to.from(length / 2));
  }

  /// The distinct R(m).
  void find_sets() {
    const std::size_t xpus = at(p_.num_xpus);
    std::vector<std::vector<char>> fed(xpus, std::vector<char>(xpus, 0));  // [m][by]
    for (std::size_t m = 0; m < xpus; ++m) fed[m][m] = 1;
    const auto waits = [&](int x, int u) {
      fed[at(in_.from_xpu[at(x)])][at(in_.from_xpu[at(u)])] = 1;
      fed[at(in_.to_xpu[at(x)])][at(in_.to_xpu[at(u)])] = 1;
    };
    for (const int d : domains_)
      for (const int i : p_.domains[at(d)].xnodes) {
        for (const EdgeEnd& link : p_.pred[at(i)]) waits(i, link.xnode);
        fed[at(in_.to_xpu[at(i)])][at(in_.from_xpu[at(i)])] = 1;
        const int module = p_.module_of[at(i)];
        if (module < 0 || p_.entry[at(i)] == 0) continue;
        for (const int u : p_.modules[at(module)].xnodes) {
          waits(i, u);
          fed[at(in_.to_xpu[at(i)])][at(in_.from_xpu[at(u)])] = 1;
        }
      }
    feeds_ = fed;
    for (std::size_t m = 0; m < xpus; ++m) feeds_[m][m] = 0;
    for (const int d : domains_)
      for (const int i : p_.domains[at(d)].xnodes)
        for (const bool second : {false, true}) {
          const std::vector<int>& xpu = second ? in_.to_xpu : in_.from_xpu;
          const int m = xpu[at(i)];
          for (const EdgeEnd& link : p_.pred[at(i)])
            if (xpu[at(link.xnode)] == m && (second ? in_.then : in_.now).transfer(link, m, m) > 0)
              feeds_[at(m)][at(m)] = 1;
        }
    for (std::size_t by = 0; by < xpus; ++by)
      for (std::size_t m = 0; m < xpus; ++m)
        for (std::size_t other = 0; fed[m][by] != 0 && other < xpus; ++other)
          fed[m][other] = static_cast<char>(fed[m][other] | fed[by][other]);
    set_of_.assign(xpus, 0);
    for (std::size_t m = 0; m < xpus; ++m) {
      if (kinds_[m] == Kind::kUnused) continue;
      const auto known = std::find(sets_.begin(), sets_.end(), fed[m]);
      set_of_[m] = static_cast<std::size_t>(known - sets_.begin());
      if (known == sets_.end()) sets_.push_back(fed[m]);
    }
  }

  /// By how much lateness falls in time: at least sigma, but where messages take time.
  void find_slope() {
    slope_ = {slack_pct_, 100};
    for (const int d : domains_)
      for (const int i : p_.domains[at(d)].xnodes) {
        Tick passes = 0, window = kMostTicks;
        for (const EdgeEnd& link : in_.then.pred[at(i)])
          passes = std::max(passes,
                            in_.then.transfer(link, in_.to_xpu[at(link.xnode)], in_.to_xpu[at(i)]));
        for (int n = 0; n < p_.jobs[at(i)]; ++n)
          window = std::min(window, in_.to.d[p_.slot_of(i, n)] - in_.to.a[p_.slot_of(i, n)]);
        // A check may know `a` a tick less well, where clocks drift.
        if (p_.domains[at(d)].ppm > 0) window = std::max(Tick{1}, window - 1);
        const __int128 up = static_cast<__int128>(slack_pct_) * window,
                       of = 100 * (static_cast<__int128>(window) + passes);
        if (up * slope_.of < slope_.up * of) slope_ = {up, of};
      }
  }

  /// Around each S, and M as far as it is this clock's. Why nothing follows; empty: it does.
  std::string find_raised(int d, std::int64_t& pairs) {
    const Domain& domain = p_.domains[at(d)];
    Tick deepest = 0;
    for (const int i : domain.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        // Where XPUs do not preempt, nobody of the first table is in the way from then on.
        const Tick a = (blocks_ ? in_.from.d : in_.from.a)[p_.slot_of(i, n)];
        last_ready_ = std::max(last_ready_, in_slow_time(a + lost_in(a, domain.ppm), domain.ppm));
        deepest = std::max({deepest, in_.from.d[p_.slot_of(i, n)], in_.to.d[p_.slot_of(i, n)]});
      }
    const Tick reach = deepest + 2 * lost_in(deepest, domain.ppm);
    for (const ReleaseTime& r : releases_of(p_, domain)) {
      LateAround around{r.at, r.before - in_fast_time(in_.notice, domain.ppm), r.before, {}, {}};
      for (const int c : domain.components)
        if (!find_raised(p_.components[at(c)], domain, r.at + reach + 2 * domain.hyper, around,
                         pairs))
          return clock_of(d) +
                 "shares XPUs, and has jobs that wait for the other table again and again";
      if (pairs < 0) return clock_of(d) + "shares XPUs, and has more jobs than are looked at";
      std::sort(around.raised.begin(), around.raised.end());
      last_ready_ = std::max(last_ready_, in_slow_time(around.waited - r.before, domain.ppm));
      of_domain_[at(d)].around.push_back(std::move(around));
    }
    return {};
  }

  /// Of one component. False: one that is released after `last` still waits past its `a`.
  bool find_raised(const Component& c, const Domain& domain, Tick last, LateAround& around,
                   std::int64_t& pairs) const {
    const auto release = [&](std::int64_t n) { return c.phase + n * c.period; };
    const auto blur = [&](Tick t) { return lost_in(t, domain.ppm); };
    const auto late = [&](Tick t) { return t + blur(t); };
    const auto first_key = [&](int u, std::int64_t n) {
      return release(n) + late(in_.from.d[p_.slot_of(u, n)]);
    };
    const std::int64_t first = floor_div(around.s - 1 - c.phase, c.period) + 1;
    std::int64_t longest_lag = 1;
    for (const int i : c.xnodes)
      if (const int m = p_.module_of[at(i)]; m >= 0 && p_.modules[at(m)].in_flight < kMillion)
        longest_lag = std::max(longest_lag, p_.modules[at(m)].in_flight);
    std::map<std::pair<std::int64_t, int>, Tick> dues;  // [n, xnode] those after keys
    std::vector<Tick> before(at(p_.num_xnodes), 0);     // [xnode] alpha of the activation before
    for (const int i : c.xnodes)
      before[at(i)] = release(first - 1) + late(in_.from.a[p_.slot_of(i, first - 1)]);
    std::vector<Tick> waits_until = before;  // [xnode] what of that is not its own `a`
    std::int64_t last_raised = first;
    for (std::int64_t n = first; n <= std::max(first, last_raised) + longest_lag; ++n) {
      for (const int i : c.xnodes) {
        if (--pairs < 0) return true;
        const std::size_t slot = p_.slot_of(i, n);
        const Tick own = release(n) + late(in_.to.a[slot]);
        const Tick key = release(n) + in_.to.d[slot] - blur(in_.to.d[slot]);
        Tick& waits = waits_until[at(i)];
        const auto after = [&](int u, std::int64_t k, Tick passes) {
          if (k < first) {
            waits = std::max(waits, first_key(u, k));
          } else if (const auto due = dues.find({k, u}); due != dues.end()) {
            waits = std::max(waits, due->second + passes);
          }
        };
        if (n == first && (in_.to_xpu[at(i)] != in_.from_xpu[at(i)] || first_key(i, n - 1) > key))
          after(i, n - 1, 0);
        for (const EdgeEnd& link : in_.then.pred[at(i)])
          after(link.xnode, n,
                in_fast_time(in_.then.transfer(link, in_.to_xpu[at(link.xnode)], in_.to_xpu[at(i)]),
                             domain.ppm));
        if (const int m = p_.module_of[at(i)]; m >= 0 && p_.entry[at(i)] != 0)
          if (const Module& of = p_.modules[at(m)]; of.in_flight < kMillion)
            for (const int u : of.xnodes) after(u, n - of.in_flight, 0);
        const Tick ready = std::max({own, before[at(i)], waits});
        before[at(i)] = ready;
        // Whether what it waits for is before its `a` is not known where it is within the drift.
        if (waits > release(n) + in_.to.a[slot] - blur(in_.to.a[slot])) {
          around.waited = std::max(around.waited, ready);
          last_raised = n;
          if (release(n) > last) return false;
        }
        if (ready <= own) continue;
        Raised job{i, n, ready};
        if (ready >= key) {
          // No earlier than its key may be: `ready` is no earlier than its `a` may be.
          job.due = ready + in_fast_time(in_.to.d[slot] - in_.to.a[slot], domain.ppm);
          dues[{n, i}] = job.due;
          around.waited = std::max(around.waited, job.due);
        }
        around.raised.push_back(job);
      }
    }
    return true;
  }

  /// The demand bounds that shares are made of.
  std::string find_dues(std::int64_t& pairs) {
    dues_.resize(p_.domains.size());
    for (const int d : domains_) {
      const Domain& domain = p_.domains[at(d)];
      const Looked looked = looks_at(d);
      const Tick notice = in_fast_time(in_.notice, domain.ppm);
      Tick gap = 0;
      for (const ReleaseTime& r : releases_of(p_, domain)) gap = std::max(gap, r.at - r.before);
      const Tick longest = looked.before + gap + notice + looked.after;
      std::vector<Due>& due = dues_[at(d)];
      due.resize(at(p_.num_xpus));
      for (int m = 0; m < p_.num_xpus; ++m) {
        const Kind kind = kinds_[at(m)];
        const bool from = kind == Kind::kLikeFrom || kind == Kind::kSplit;
        const bool to = kind == Kind::kLikeTo || kind == Kind::kSplit;
        if ((from && !dbf(d, m, false, longest, pairs, due[at(m)].from)) ||
            (to && !dbf(d, m, true, longest, pairs, due[at(m)].to)))
          return clock_of(d) + "shares XPUs, and has more jobs than are looked at";
      }
    }
    return {};
  }

  /// How far before t_lo, and after S; M and 2b in the clock's time.
  struct Looked {
    Tick before, after, last_ready, shorter;
  };
  [[nodiscard]] Looked looks_at(int d) const {
    const Domain& domain = p_.domains[at(d)];
    Tick deepest = 0;
    for (const int i : domain.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n)
        deepest = std::max({deepest, in_.from.d[p_.slot_of(i, n)], in_.to.d[p_.slot_of(i, n)]});
    const Tick shorter = 2 * lost_in(deepest, domain.ppm);
    // Who is let in may wait for a job of one hyperperiod before: so w(L) further.
    const Tick in = in_fast_time(*std::max_element(lets_in_.begin(), lets_in_.end()), domain.ppm);
    const Tick far = deepest + shorter + 2 * domain.hyper + shorter + in;
    const Tick last_ready = last_ready_ + lost_in(last_ready_, domain.ppm);
    return {far, far + last_ready, last_ready, shorter};
  }

  std::string derive(int d, std::int64_t& pairs, const Until& until) {
    const Domain& domain = p_.domains[at(d)];
    const std::int64_t ppm = domain.ppm;
    Lateness& lateness = of_domain_[at(d)];
    const Looked looked = looks_at(d);
    const std::vector<ReleaseTime> all = releases_of(p_, domain);
    const std::vector<Due>& due = dues_[at(d)];
    for (std::size_t k = 0; k < all.size(); ++k) {
      const ReleaseTime& r = all[k];
      LateAround& around = lateness.around[k];
      std::vector<std::vector<Job>> jobs(at(p_.num_xpus));
      const Range look{around.since - looked.before, r.at + looked.last_ready, r.at + looked.after};
      if (!list(d, around, look, jobs))
        return clock_of(d) +
               "shares XPUs, and has jobs on them that wait for the other table until after their "
               "keys";
      for (const std::vector<Job>& of : jobs) pairs -= static_cast<std::int64_t>(of.size());
      around.rises.assign(sets_.size(), {});
      for (std::vector<Job>& of : jobs)
        std::sort(of.begin(), of.end(),
                  [](const Job& a, const Job& b) { return a.ready > b.ready; });
      for (std::size_t set = 0; set < sets_.size() && pairs >= 0; ++set)
        lateness.line[set] =
            std::max(lateness.line[set],
                     rise(around, set, look, r.before, looked.shorter, ppm, due, jobs, pairs));
      if (pairs < 0 || until.over())
        return clock_of(d) + "shares XPUs, and has more jobs than are looked at";
      for (std::size_t set = 0; set < sets_.size(); ++set)
        if (!around.rises[set].empty())
          lateness.most[set] = std::max(lateness.most[set], around.rises[set].back().by);
    }
    return {};
  }

  /// The demand bound of a clock on a shared XPU, with each job's cost, no drift. False: too many.
  bool dbf(int d, int m, bool second, Tick longest, std::int64_t& pairs,
           std::vector<Step>& steps) const {
    Pattern pattern = pattern_of(d, m, second, 0);
    pattern.ppm = 0;
    return demand_curve(pattern, longest, pairs, steps);
  }

  /// All jobs that matter, by XPU. False: one is ready after its key.
  bool list(int d, const LateAround& around, const Range& look,
            std::vector<std::vector<Job>>& jobs) const {
    const Domain& domain = p_.domains[at(d)];
    const auto blur = [&](Tick t) { return lost_in(t, domain.ppm); };
    bool fits = true;
    // Those that lateness lets in.
    const Tick in = in_fast_time(*std::max_element(lets_in_.begin(), lets_in_.end()), domain.ppm);
    for (const int i : domain.xnodes) {
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      const auto release = [&](std::int64_t n) { return c.phase + n * c.period; };
      const auto add = [&](std::int64_t n, bool second, Tick ready, Tick due) {
        const int m = (second ? in_.to_xpu : in_.from_xpu)[at(i)];
        Job job = job_of(i, n, second, domain.ppm);
        job.ready = ready;
        job.due = due;
        if (!second && job.late_key >= around.since) job.work = cost_of(in_.both, i, m);
        // On a shared XPU it goes before all jobs of other clocks that lie between its key and its alpha.
        fits = fits && (ready < job.key || (due != kNoTick && kinds_[at(m)] == Kind::kAlone));
        jobs[at(m)].push_back(job);
      };
      std::int64_t n = floor_div(around.s - 1 - c.phase, c.period);
      for (; release(n) + in_.from.d[p_.slot_of(i, n)] >= look.low - 4 * blur(look.high - look.low);
           --n) {
        const Tick a = in_.from.a[p_.slot_of(i, n)];
        add(n, false, release(n) + a + blur(a), kNoTick);
      }
      n = floor_div(around.s - 1 - c.phase, c.period) + 1;
      for (; release(n) <= look.high + in; ++n) {
        const Tick a = in_.to.a[p_.slot_of(i, n)];
        const Raised* raised = around.find(i, n);
        if (raised != nullptr)
          add(n, true, raised->ready, raised->due);
        else
          add(n, true, release(n) + a + blur(a), kNoTick);
      }
    }
    return fits;
  }

  [[nodiscard]] static Tick value_at(const std::vector<Step>& steps, Tick length) {
    const auto next = std::upper_bound(steps.begin(), steps.end(), length,
                                       [](Tick l, const Step& s) { return l < s.length; });
    return next == steps.begin() ? 0 : (next - 1)->value;
  }
  /// f(x, y), of both tables: the least over all S' in [first, last]. The part of the second one falls as
  /// S' grows. So it is just before the first one's part rises, or at the end.
  static Tick split_share(const Due& due, Tick x, Tick y, Tick first, Tick last, Tick shorter,
                          std::int64_t& pairs) {
    first = std::clamp(first, x, y);
    last = std::clamp(last, x, y);
    auto next = std::upper_bound(due.from.begin(), due.from.end(), first - x - shorter,
                                 [](Tick l, const Step& s) { return l < s.length; });
    Tick least = kMostTicks;
    while (true) {
      --pairs;
      const Tick rises = next == due.from.end() ? last : x + shorter + next->length;
      least = std::min(least, (next == due.from.begin() ? 0 : (next - 1)->value) +
                                  value_at(due.to, y - std::min(rises, last) - shorter));
      if (rises >= last) return least;
      ++next;
    }
  }

  /// Fills around.rises. Returns the largest of up * y + of * what is reached at y, for the keys y after the
  /// release before S on XPUs of this clock alone, up / of the slope: from where lateness may fall.
  __int128 rise(LateAround& around, std::size_t set, const Range& look, Tick last, Tick shorter,
                std::int64_t ppm, const std::vector<Due>& due,
                const std::vector<std::vector<Job>>& jobs, std::int64_t& pairs) const {
    Rises& rises = around.rises[set];
    std::vector<At> keys;
    for (int m = 0; m < p_.num_xpus; ++m) {
      if (sets_[set][at(m)] == 0) continue;
      // Another clock's key may be just after t_lo.
      if (!jobs[at(m)].empty()) keys.push_back({around.since, m, nullptr});
      const auto add = [&](Tick y, const Job* due_of) {
        if (y > around.since && y <= look.high) keys.push_back({y, m, due_of});
      };
      for (const Job& job : jobs[at(m)]) {
        add(job.key, nullptr);
        if (job.due != kNoTick) add(job.due, &job);
      }
    }
    std::sort(keys.begin(), keys.end(), [](const At& a, const At& b) { return a.key < b.key; });
    __int128 line = 0;
    for (const At& y : keys) {
      const Kind kind = kinds_[at(y.xpu)];
      const bool alone = kind == Kind::kAlone;
      // Just after t_lo: another clock's key may be there; this one's only if it is not known better.
      const bool blocks =
          p_.preemptive[at(y.xpu)] == 0 &&
          (y.key > around.since ||
           std::any_of(jobs[at(y.xpu)].begin(), jobs[at(y.xpu)].end(),
                       [&](const Job& job) { return job.key <= y.key && job.late_key >= y.key; }));
      const Tick in = in_fast_time(lets_in_[at(y.xpu)], ppm);
      const std::vector<Job> met =
          alone && blocks ? who_blocks(jobs[at(y.xpu)], y, in) : std::vector<Job>{};
      const std::vector<Step>& steps =
          kind == Kind::kLikeTo ? due[at(y.xpu)].to : due[at(y.xpu)].from;
      const Tick so_far = rises.empty() ? 0 : rises.back().by;
      std::optional<Tick> most;
      Tick sum = 0;
      std::size_t step = 0;
      const auto look_at = [&](Tick x) {
        const Tick length = y.key - x;
        Tick served = 0;
        if (alone) {
          served = std::max(Tick{0}, length - lost_in(length, ppm));
        } else if (kind == Kind::kSplit) {
          served = split_share(due[at(y.xpu)], x, y.key, last, around.s, shorter, pairs);
        } else {
          while (step < steps.size() && steps[step].length <= length - shorter) ++step;
          served = step == 0 ? 0 : steps[step - 1].value;
        }
        Tick excess = sum - served;
        if (kind != Kind::kAlone && kind != Kind::kLikeFrom && x > last + (look.end - around.s))
          excess = std::min(excess, in_slow_time(shorter, ppm));
        if (blocks)
          excess += alone ? blocked(met, x, y.key, in)
                          : lack(y.xpu, std::max(Tick{0}, length - lost_in(length, ppm)));
        const Tick reached = late_at(rises, x) + excess;
        most = std::max(most.value_or(reached), reached);
      };
      // Another clock's alpha may be just before `end`.
      bool at_end = alone || look.end >= y.key;
      for (const Job& x : jobs[at(y.xpu)]) {
        if (x.key > y.key) continue;
        if (x.ready < look.low) break;
        if (--pairs < 0) return line;
        if (x.ready < look.end && !at_end) {
          if (sum > 0) look_at(look.end);
          at_end = true;
        }
        sum += x.work;
        if (x.ready < look.end && x.ready < y.key) look_at(x.ready);
      }
      if (!at_end && sum > 0) look_at(look.end);
      if (!most) continue;
      if (alone)
        line = std::max(line, slope_.up * (in_slow_time(std::max(Tick{0}, y.key - last), ppm) +
                                           2 * lost_in(last_ready_, ppm)) +
                                  slope_.of * *most);
      if (*most > so_far) rises.push_back({y.key == around.since ? y.key + 1 : y.key, *most});
    }
    return line;
  }

  const HandoverInput& in_;
  const Problem& p_;
  const std::vector<int> domains_;
  std::vector<Kind> kinds_;               ///< [xpu]
  bool blocks_ = false;                   ///< an XPU does not preempt
  Tick shift_ = 0;                        ///< beta
  std::vector<std::vector<char>> feeds_;  ///< [m][by] directly
  std::vector<Tick> lets_in_;             ///< [xpu] L
  struct Lacks {
    Lack from, to;
  };
  std::vector<Lacks> lacks_;            ///< [xpu] G of both tables
  std::vector<std::vector<Due>> dues_;  ///< [domain][xpu]
  int slack_pct_ = 0;
  struct Slope {
    __int128 up = 1, of = 1;
  } slope_;
  Tick last_ready_ = 0;                  ///< M, in real time
  std::vector<std::vector<char>> sets_;  ///< [set][xpu]
  std::vector<std::size_t> set_of_;      ///< [xpu] R(m)
  std::vector<Lateness> of_domain_;
  std::vector<Tick> most_;  ///< [set]
  Tick settles_ = 0;
};

/// What a walk tells of jobs (handover_walk.h), by theorem 10.
struct MaybeLate {
  const Unchanged from, to;
  const LateAround& around;
  const HandoverInput& in;
  const Cluster& cluster;
  int domain;
  [[nodiscard]] bool on_time(int xnode, std::int64_t n) const {
    return release(xnode, n) < around.s && from.ends(xnode, n) < around.since;
  }
  [[nodiscard]] const Unchanged& table(int xnode, std::int64_t n) const {
    return release(xnode, n) < around.s ? from : to;
  }
  [[nodiscard]] Tick release(int xnode, std::int64_t n) const { return from.release(xnode, n); }
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const {
    Tick key = table(xnode, n).ends(xnode, n);
    if (on_time(xnode, n)) return key;
    const bool first = release(xnode, n) < around.s;
    const std::size_t set = cluster.set_of((first ? in.from_xpu : in.to_xpu)[at(xnode)]);
    if (const Raised* raised = around.find(xnode, n); raised != nullptr && raised->due != kNoTick)
      key = raised->due;
    return key + in_fast_time(late_at(around.rises[set], key) + cluster.most_of_others(domain, set),
                              from.ppm);
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

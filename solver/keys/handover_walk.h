// SPDX-License-Identifier: Apache-2.0
// The jobs of one clock around one change of tables, walked by their keys: docs/keys.md, theorem 8,
// whose words these are. handover.cc alone reads it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <optional>
#include <queue>
#include <tuple>
#include <vector>

#include "solver/keys/handover.h"

namespace xauto::solver::keys::handover {

/// A walk that is not settled after so many hyperperiods, or jobs, never is, for us.
inline constexpr int kMostHyperperiods = 40;
[[nodiscard]] inline std::int64_t most_of_walk(const Domain& domain) {
  return 10'000 + 4 * domain.jobs;
}

/// floor(t * 10^6 / (10^6 + ppm)), t >= 0: the least of a clock's time that `t` takes.
inline Tick least_of_clock(Tick t, std::int64_t ppm) {
  return static_cast<Tick>(static_cast<__int128>(t) * kMillion / (kMillion + ppm));
}

/// Nominal releases of a hyperperiod, each once, with the one that precedes it.
struct ReleaseTime {
  Tick at, before;
};
[[nodiscard]] inline std::vector<ReleaseTime> releases_of(const Problem& p, const Domain& domain) {
  std::vector<Tick> all;
  for (const int c : domain.components)
    for (int n = 0; n < p.components[at(c)].jobs; ++n)
      all.push_back((p.components[at(c)].phase + n * p.components[at(c)].period) % domain.hyper);
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  std::vector<ReleaseTime> releases;
  Tick before = all.back() - domain.hyper;
  for (const Tick t : all) {
    releases.push_back({t, before});
    before = t;
  }
  return releases;
}

/// One table alone, with what Walk tells of a change.
struct Unchanged {
  const Problem& p;
  const Windows& w;
  std::int64_t ppm;
  [[nodiscard]] Tick release(int xnode, std::int64_t n) const {
    const Component& c = p.components[at(p.component_of[at(xnode)])];
    return c.phase + n * c.period;
  }
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const {
    const Tick d = w.d[p.slot_of(xnode, n)];
    return release(xnode, n) + d + lost_in(d, ppm);
  }
  [[nodiscard]] Tick held(int xnode, std::int64_t n) const {
    return release(xnode, n) + hold(xnode, n) - lost_in(hold(xnode, n), ppm);
  }
  [[nodiscard]] std::optional<Tick> key(int xnode, std::int64_t n) const {
    return w.d[p.slot_of(xnode, n)];
  }
  [[nodiscard]] Tick hold(int xnode, std::int64_t n) const { return w.hold[p.slot_of(xnode, n)]; }
  [[nodiscard]] Tick most_hold(int xnode) const {
    const auto first = w.hold.begin() + p.slot[at(xnode)];
    return *std::max_element(first, first + p.jobs[at(xnode)]);
  }
};

/// Walks the jobs of one domain around one S. Time is the domain's clock.
class Walk {
 public:
  Walk(const HandoverInput& in, int domain)
      : in_(in),
        p_(in.now),
        domain_(in.now.domains[at(domain)]),
        ppm_(domain_.ppm),
        from_{p_, in.from, ppm_},
        to_{p_, in.to, ppm_},
        by_xpu_(at(p_.num_xpus)) {
    first_.assign(at(p_.num_xnodes), 0);
    index_.resize(at(p_.num_xnodes));
    for (const int i : domain_.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n)
        deepest_ = std::max({deepest_, in.from.d[p_.slot_of(i, n)], in.to.d[p_.slot_of(i, n)]});
    blur_ = blur(deepest_);
    reach_ = deepest_ + 2 * blur_;
  }

  /// t is in [since, until], S is after all of the first table's releases. False: not settled within
  /// `most` jobs.
  bool run(Tick s, Tick since, Tick until, std::int64_t most) {
    begin(s, since, until);
    most = std::min(most, walked_ + most_of_walk(domain_));
    for (const int i : domain_.xnodes) add_before(i);
    plan_all();
    settled_by_ = last_late_ + 2 * reach_ + domain_.hyper;
    extend(s + reach_ + domain_.hyper);
    while (!settled()) {
      if (horizon_ > s + kMostHyperperiods * domain_.hyper + 4 * reach_ || walked_ > most)
        return false;
      if (ready_.empty() || jobs_[at(ready_.top().job)].key > horizon_) {
        extend(horizon_ + domain_.hyper);
        continue;
      }
      // Of keys that may be equal it is known first by when all of them are ready: else the one that comes
      // later would count as if it might be ready at any time, again and again.
      const Tick key = latest_key(jobs_[at(ready_.top().job)]);
      equals_.clear();
      for (; !ready_.empty() && earliest_key(jobs_[at(ready_.top().job)]) <= key; ready_.pop())
        equals_.push_back(ready_.top().job);
      for (const int x : equals_) make_ready(x);
      for (const int x : equals_) visit(x);
      walked_ += static_cast<std::int64_t>(equals_.size());
    }
    return true;
  }
  /// From S on.
  [[nodiscard]] Tick settles() const { return settled_by_ - s_; }
  /// Whoever is released later is as the second table says.
  [[nodiscard]] Tick last_late() const { return last_late_; }

  [[nodiscard]] Tick release(int xnode, std::int64_t n) const { return from_.release(xnode, n); }
  /// By when activation n has ended.
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const {
    const int x = find(xnode, n);
    if (x >= 0 && jobs_[at(x)].walked) return jobs_[at(x)].ends;
    return alone(xnode, n).ends(xnode, n);
  }
  /// Before which activation n does not start.
  [[nodiscard]] Tick held(int xnode, std::int64_t n) const {
    return alone(xnode, n).held(xnode, n);
  }
  /// After its release, if it has ended by its key.
  [[nodiscard]] std::optional<Tick> key(int xnode, std::int64_t n) const {
    const int x = find(xnode, n);
    if (x >= 0 && jobs_[at(x)].walked && !jobs_[at(x)].clean) return std::nullopt;
    return alone(xnode, n).key(xnode, n);
  }
  [[nodiscard]] Tick hold(int xnode, std::int64_t n) const {
    return alone(xnode, n).hold(xnode, n);
  }
  /// By how much a length that counts from a release may be another one of the clock's.
  [[nodiscard]] Tick blur(Tick length) const { return lost_in(length, ppm_); }
  [[nodiscard]] Tick most_hold(int xnode) const {
    return std::max(from_.most_hold(xnode), to_.most_hold(xnode));
  }

 private:
  struct Job {
    int xnode, xpu;
    std::int64_t n;
    Tick release, key, starts;  ///< starts: not before
    Tick blur;                  ///< of the key
    Tick wcet;
    bool second, walked = false, visited = false;
    bool on_time = false;  ///< ready by the second table's `a`
    bool clean = false;    ///< ends by that table's key
    int waits = 0;         ///< for so many that are not walked
    Tick ready = 0, ends = 0, work = 0;
  };
  struct Next {
    Tick key, release;
    int job;
    bool operator>(const Next& o) const {
      return std::tie(key, release, job) > std::tie(o.key, o.release, o.job);
    }
  };
  /// One that is walked, of an XPU.
  struct Done {
    Tick ready, work, ends;
    Tick all_end;  ///< of all up to this one
    int job;
  };
  /// A job of the first table on an XPU, had there been no change.
  struct Planned {
    Tick key, late;  ///< at the earliest, at the latest
    Tick work;
    Tick begun = 0;  ///< the latest key less all work, of those up to here; the least so far
  };
  static constexpr Tick kNotYet = kForever;  ///< its end is not known yet
  struct OnXpu {
    std::vector<int> by_key;    ///< all, the walked ones too
    std::size_t first = 0;      ///< all before it are walked
    std::vector<Done> done;     ///< by `ready`
    std::vector<int> of_first;  ///< jobs of the first table
    std::vector<Planned> plan;
  };

  void begin(Tick s, Tick since, Tick until) {
    s_ = s;
    since_ = since;
    until_ = until;
    horizon_ = s;
    last_late_ = s;
    known_all_ = false;
    jobs_.clear();
    ready_ = {};
    for (const int i : domain_.xnodes) {
      index_[at(i)].clear();
      first_[at(i)] = 0;
    }
    for (OnXpu& m : by_xpu_) m = {};
  }

  [[nodiscard]] static Tick earliest_key(const Job& j) { return j.key - j.blur; }
  [[nodiscard]] static Tick latest_key(const Job& j) { return j.key + j.blur; }
  /// Of the second table: by then it is to be ready.
  [[nodiscard]] Tick earliest_ready(const Job& j) const {
    const Tick a = in_.to.a[p_.slot_of(j.xnode, j.n)];
    return j.release + a - blur(a);
  }

  /// The table that the activation has.
  [[nodiscard]] const Unchanged& alone(int xnode, std::int64_t n) const {
    return release(xnode, n) < s_ ? from_ : to_;
  }
  [[nodiscard]] int find(int xnode, std::int64_t n) const {
    const auto& index = index_[at(xnode)];
    const std::int64_t k = n - first_[at(xnode)];
    if (k < 0 || k >= static_cast<std::int64_t>(index.size())) return -1;
    return index[static_cast<std::size_t>(k)];
  }

  /// The first activation that is not released before `time`.
  [[nodiscard]] std::int64_t from_on(int xnode, Tick time) const {
    const Component& c = p_.components[at(p_.component_of[at(xnode)])];
    return floor_div(time - 1 - c.phase, c.period) + 1;
  }

  /// What the first table would execute from t on: it suffices to know a hyperperiod of it.
  void plan(int xnode) {
    const int xpu = in_.from_xpu[at(xnode)];
    for (std::int64_t n = first_[at(xnode)]; release(xnode, n) < s_ + domain_.hyper; ++n) {
      const Tick d = in_.from.d[p_.slot_of(xnode, n)], key = release(xnode, n) + d;
      if (key <= s_ + domain_.hyper)
        by_xpu_[at(xpu)].plan.push_back(
            {key - blur(d), key + blur(d), least_of_clock(p_.wcet(xnode, xpu), ppm_)});
    }
  }
  void plan_all() {
    for (const int i : domain_.xnodes) plan(i);
    for (OnXpu& m : by_xpu_) {
      std::sort(m.plan.begin(), m.plan.end(),
                [](const Planned& a, const Planned& b) { return a.key < b.key; });
      Tick work = 0, late = 0;
      for (std::size_t k = 0; k < m.plan.size(); ++k) {
        work += m.plan[k].work;
        late = k == 0 ? m.plan[k].late : std::max(late, m.plan[k].late);
        m.plan[k].begun = late - work;
        if (k > 0) m.plan[k].begun = std::min(m.plan[k].begun, m.plan[k - 1].begun);
      }
    }
  }
  /// As if all that counts, with keys up to `key`, had begun by then.
  [[nodiscard]] Tick begun_by(const OnXpu& m, Tick key) const {
    const auto next = std::upper_bound(m.plan.begin(), m.plan.end(), key,
                                       [](Tick k, const Planned& p) { return k < p.key; });
    return next == m.plan.begin() ? until_ : std::min(until_, (next - 1)->begun);
  }

  /// Activations of the first table that may not have ended.
  void add_before(int xnode) {
    const std::int64_t end = from_on(xnode, s_);
    std::int64_t n = end;
    while (from_.ends(xnode, n - 1) >= until_) --n;
    first_[at(xnode)] = n;
    for (; n < end; ++n) {
      const int x = add(xnode, n, false);
      last_late_ = std::max(last_late_, latest_key(jobs_[at(x)]));
    }
  }

  int add(int xnode, std::int64_t n, bool second) {
    const Tick released = release(xnode, n);
    const Windows& w = second ? in_.to : in_.from;
    const std::size_t slot = p_.slot_of(xnode, n);
    const int xpu = second ? in_.to_xpu[at(xnode)] : in_.from_xpu[at(xnode)];
    Job job{xnode, xpu, n, released, released + w.d[slot], 0, blur(w.d[slot]), 0, second};
    job.starts = released + w.e[slot] - blur(w.e[slot]);
    job.wcet = in_fast_time((second ? in_.then : in_.both).wcet(xnode, xpu), ppm_);
    const auto x = static_cast<int>(jobs_.size());
    jobs_.push_back(job);
    index_[at(xnode)].push_back(x);
    by_xpu_[at(xpu)].by_key.push_back(x);
    if (!second) by_xpu_[at(xpu)].of_first.push_back(x);
    return x;
  }

  /// All releases before `time`.
  void extend(Tick time) {
    const std::size_t known = jobs_.size();
    for (const int i : domain_.xnodes)
      for (std::int64_t n = std::max(
               first_[at(i)] + static_cast<std::int64_t>(index_[at(i)].size()), from_on(i, s_));
           release(i, n) < time; ++n)
        add(i, n, true);
    horizon_ = time;
    const std::size_t begin = known_all_ ? known : 0;
    known_all_ = true;
    for (std::size_t x = begin; x < jobs_.size(); ++x) count_waits(static_cast<int>(x));
    for (OnXpu& m : by_xpu_)
      std::sort(m.by_key.begin() + static_cast<std::ptrdiff_t>(m.first), m.by_key.end(),
                [&](int a, int b) { return jobs_[at(a)].key < jobs_[at(b)].key; });
  }

  /// each(job that `x` waits for)
  template <class Each>
  void waited_for(const Job& x, Each each) const {
    for (const EdgeEnd& link : p_.pred[at(x.xnode)])
      if (const int u = find(link.xnode, x.n); u >= 0) each(u);
    if (const int u = find(x.xnode, x.n - 1); u >= 0) each(u);
    const int module = p_.module_of[at(x.xnode)];
    if (module < 0 || p_.entry[at(x.xnode)] == 0) return;
    const Module& m = p_.modules[at(module)];
    if (m.in_flight >= kMillion) return;
    for (const int i : m.xnodes)
      if (const int u = find(i, x.n - m.in_flight); u >= 0) each(u);
  }

  void count_waits(int x) {
    jobs_[at(x)].waits = 0;
    waited_for(jobs_[at(x)], [&](int u) { jobs_[at(x)].waits += jobs_[at(u)].walked ? 0 : 1; });
    if (jobs_[at(x)].waits == 0) ready_.push({jobs_[at(x)].key, jobs_[at(x)].release, x});
  }

  void one_less(int x) {
    if (x < 0 || jobs_[at(x)].walked) return;
    if (--jobs_[at(x)].waits == 0) ready_.push({jobs_[at(x)].key, jobs_[at(x)].release, x});
  }

  /// Those that wait for `x`, as waited_for counts.
  void release_waiting(const Job& x) {
    for (const EdgeEnd& link : p_.succ[at(x.xnode)]) one_less(find(link.xnode, x.n));
    one_less(find(x.xnode, x.n + 1));
    const int module = p_.module_of[at(x.xnode)];
    if (module < 0) return;
    const Module& m = p_.modules[at(module)];
    if (m.in_flight >= kMillion) return;
    for (const int e : m.entries) one_less(find(e, x.n + m.in_flight));
  }

  /// j cannot start before z has ended.
  [[nodiscard]] bool waits_for(const Job& j, const Job& z) const {
    if (p_.component_of[at(j.xnode)] != p_.component_of[at(z.xnode)]) return false;
    if (j.xnode == z.xnode) return j.n > z.n;
    if (j.n >= z.n && p_.before(z.xnode, j.xnode)) return true;
    const int module = p_.module_of[at(j.xnode)];
    return module >= 0 && module == p_.module_of[at(z.xnode)] &&
           j.n - z.n >= p_.modules[at(module)].in_flight;
  }

  /// A(x), and whether that is known to be in time.
  void set_ready(Job& x) const {
    const auto long_at_most = [&](Tick length) { return in_fast_time(length, ppm_); };
    const std::size_t slot = p_.slot_of(x.xnode, x.n);
    const Windows& w = x.second ? in_.to : in_.from;
    const std::vector<int>& xpu = x.second ? in_.to_xpu : in_.from_xpu;
    const Problem& of_table = x.second ? in_.then : in_.now;  // it may have a message less
    const Tick in_time = x.second ? earliest_ready(x) : 0;
    const bool root = p_.root[at(x.xnode)] != 0;
    Tick ready = x.release + (root ? long_at_most(p_.root_ready[at(x.xnode)]) : 0);
    ready = std::max(ready, x.release + long_at_most(w.hold[slot]));
    x.on_time = x.second;
    const auto after = [&](int xnode, std::int64_t n, Tick passes) {
      const Tick left = ends(xnode, n) + passes;
      ready = std::max(ready, left);
      const int u = find(xnode, n);
      x.on_time = x.on_time && (left <= in_time || (u >= 0 && jobs_[at(u)].clean));
    };
    for (const EdgeEnd& link : of_table.pred[at(x.xnode)])
      after(link.xnode, x.n,
            long_at_most(of_table.transfer(link, xpu[at(link.xnode)], xpu[at(x.xnode)])));
    if (const int u = find(x.xnode, x.n - 1); u >= 0) {
      const Job& last = jobs_[at(u)];
      const bool ordered =
          last.xpu == x.xpu && (last.second == x.second || latest_key(last) <= earliest_key(x));
      const Tick left = ordered ? last.ready : last.ends;
      ready = std::max(ready, left);
      x.on_time = x.on_time && (left <= in_time || (ordered && last.on_time));
    }
    const int module = p_.module_of[at(x.xnode)];
    if (module >= 0 && p_.entry[at(x.xnode)] != 0) {
      const Module& m = p_.modules[at(module)];
      if (m.in_flight < kMillion)
        for (const int i : m.xnodes) after(i, x.n - m.in_flight, 0);
    }
    x.ready = ready;
  }

  /// Jobs of its XPU that may have larger keys and may have started before `time`; neither waits for the
  /// other.
  template <class Each>
  void larger(const Job& x, Tick time, Each each) const {
    const std::vector<int>& by_key = by_xpu_[at(x.xpu)].by_key;
    auto j = std::upper_bound(by_key.begin(), by_key.end(), earliest_key(x) - blur_,
                              [&](Tick key, int job) { return key < jobs_[at(job)].key; });
    for (; j != by_key.end() && jobs_[at(*j)].key < time + deepest_ + blur_; ++j) {
      const Job& other = jobs_[at(*j)];
      if (latest_key(other) <= earliest_key(x) || other.starts >= time) continue;
      if (waits_for(other, x) || (other.key <= x.key && is_or_before(other, x))) continue;
      each(*j);
    }
  }
  /// Only for keys that may be equal: `u` is x, or x waits for it.
  [[nodiscard]] bool is_or_before(const Job& u, const Job& x) const {
    return (u.xnode == x.xnode && u.n == x.n) || waits_for(x, u);
  }

  /// Who pays for a job of the first table is not in time by the second one's certificate, which does not
  /// know that job.
  void set_work(Job& x) const {
    x.work = x.wcet;
    const Tick cost = in_fast_time(p_.preempt[at(x.xpu)], ppm_);
    if (p_.preemptive[at(x.xpu)] == 0 || cost == 0) return;
    bool preempts = false, known = false;
    larger(x, x.ready, [&](int j) {
      if (jobs_[at(j)].xnode == x.xnode) return;
      preempts = true;
      known |= jobs_[at(j)].second;
    });
    if (!preempts) return;
    x.work += cost;
    x.on_time = x.on_time && known;
  }

  /// A job that x's XPU may be busy with, and that it does not interrupt.
  struct Blocker {
    int job;
    Tick less;  ///< work of those that it waits for
  };

  /// A(x), its work, and its place among those of its XPU.
  void make_ready(int index) {
    set_ready(jobs_[at(index)]);
    const Tick last = std::max(jobs_[at(index)].ready, jobs_[at(index)].key + blur_) + blur_;
    if (last >= horizon_) extend(last + domain_.hyper);
    Job& x = jobs_[at(index)];
    set_work(x);
    x.walked = true;
    OnXpu& m = by_xpu_[at(x.xpu)];
    const auto place = std::upper_bound(m.done.begin(), m.done.end(), x.ready,
                                        [](Tick ready, const Done& d) { return ready < d.ready; });
    const auto here = m.done.insert(place, {x.ready, x.work, kNotYet, 0, index});
    set_all_end(m, static_cast<std::size_t>(here - m.done.begin()));
  }

  static void set_all_end(OnXpu& m, std::size_t from) {
    for (std::size_t d = from; d < m.done.size(); ++d)
      m.done[d].all_end = std::max(m.done[d].ends, d == 0 ? m.done[d].ends : m.done[d - 1].all_end);
  }

  /// F(x).
  void visit(int index) {
    Job& x = jobs_[at(index)];
    OnXpu& m = by_xpu_[at(x.xpu)];
    // Where not any number may have started, whoever has counts as the last.
    const bool blocks = p_.levels[at(x.xpu)] != kAnyLevels;
    const Tick cost = p_.preemptive[at(x.xpu)] == 0 ? 0 : in_fast_time(p_.preempt[at(x.xpu)], ppm_);
    std::vector<Blocker> blockers;
    if (blocks) larger(x, std::max(x.ready, until_), [&](int j) { blockers.push_back({j, 0}); });
    const auto pass = [&](int z) {
      for (Blocker& b : blockers)
        if (waits_for(jobs_[at(b.job)], jobs_[at(z)])) b.less += jobs_[at(z)].work;
    };
    const auto blocked = [&](Tick s) {
      Tick most = 0;
      for (const Blocker& b : blockers)
        if (jobs_[at(b.job)].starts < s)
          most = std::max(most, jobs_[at(b.job)].wcet + cost - b.less);
      return most;
    };
    // The second table's certificate does not know jobs of the first one: who blocks x at s, or is there to
    // be preempted, at a cost, by what comes from s on.
    const auto meets_first = [&](Tick s, Tick least_key) {
      if (!blocks && cost == 0) return false;
      return std::any_of(m.of_first.begin(), m.of_first.end(), [&](int j) {
        const Job& v = jobs_[at(j)];
        if (blocks && v.starts < s && latest_key(v) > earliest_key(x)) return true;
        return cost > 0 && (!v.visited || v.ends > s) && latest_key(v) > least_key;
      });
    };
    const auto may_be_first = [&](const Job& z) { return earliest_key(z) <= latest_key(x); };
    // What q's certificate says of x holds for a sum of nothing but jobs of q that are ready in time.
    bool certified = true;
    Tick opens = kNotYet;      // the first of their windows, at the earliest
    Tick least_key = kNotYet;  // of them
    x.clean = x.on_time;
    Tick ends = x.ready + x.work;
    const auto sum_is = [&](Tick by, bool of_q) {
      ends = std::max(ends, by);
      x.clean = x.clean && (of_q || by <= earliest_key(x));
    };
    // Not walked, and not less urgent: in all sums.
    Tick sum = 0;
    for (std::size_t k = m.first;
         k < m.by_key.size() && jobs_[at(m.by_key[k])].key <= latest_key(x) + blur_; ++k) {
      Job& z = jobs_[at(m.by_key[k])];
      if (z.walked || !may_be_first(z)) continue;
      z.work = z.wcet + cost;
      sum += z.work;
      certified = false;
      pass(m.by_key[k]);
    }
    bool all = true;  // the rest counts
    std::size_t k = m.done.size();
    while (k > 0 && m.done[k - 1].ready > since_) {
      const Tick s = m.done[k - 1].ready;
      for (; k > 0 && m.done[k - 1].ready == s; --k) {
        const Job& z = jobs_[at(m.done[k - 1].job)];
        if (!may_be_first(z)) continue;  // walked before: x waited for it
        sum += m.done[k - 1].work;
        certified = certified && z.on_time;
        if (z.on_time) opens = std::min(opens, earliest_ready(z));
        least_key = std::min(least_key, earliest_key(z));
        if (blocks) pass(m.done[k - 1].job);
      }
      if (s > x.ready) continue;
      sum_is(s + sum + blocked(s), certified && !meets_first(s, least_key));
      // What is ready earlier has ended by s: then its work fits between, and an earlier s gives no
      // more, nor does t (its F is at least its own first s, or begun_by, and all of that work). But
      // what q's certificate says needs that it has ended before the first window opens.
      if (s < until_) continue;
      const Tick ended = k == 0 ? -kNotYet : m.done[k - 1].all_end;
      const bool goes_on = x.clean && s + sum + blocked(s) > earliest_key(x) && ended > opens;
      if (ended <= s && !goes_on) {
        all = false;
        break;
      }
    }
    if (all) {
      for (; k > 0; --k) {
        if (!may_be_first(jobs_[at(m.done[k - 1].job)])) continue;
        sum += m.done[k - 1].work;
        if (blocks) pass(m.done[k - 1].job);
      }
      sum_is(begun_by(m, latest_key(x)) + sum + blocked(until_), false);
    }
    x.ends = x.clean ? std::min(ends, latest_key(x)) : ends;
    x.visited = true;
    std::size_t mine = m.done.size();
    while (m.done[--mine].job != index) {
    }
    m.done[mine].ends = x.ends;
    set_all_end(m, mine);
    while (m.first < m.by_key.size() && jobs_[at(m.by_key[m.first])].walked) ++m.first;
    if (!x.clean) {
      last_late_ = std::max({last_late_, latest_key(x), x.ready, x.ends});
      settled_by_ = last_late_ + 2 * reach_ + domain_.hyper;
    }
    const Job copy = x;
    release_waiting(copy);
  }

  /// None is late any more: all up to there are walked.
  [[nodiscard]] bool settled() const {
    if (horizon_ <= settled_by_) return false;
    return std::all_of(by_xpu_.begin(), by_xpu_.end(), [&](const OnXpu& m) {
      return m.first == m.by_key.size() || jobs_[at(m.by_key[m.first])].key > settled_by_;
    });
  }

  const HandoverInput& in_;
  const Problem& p_;
  const Domain& domain_;
  const std::int64_t ppm_;
  const Unchanged from_, to_;
  Tick deepest_ = 0, blur_ = 0;  ///< the largest key, and its blur
  Tick reach_ = 0;               ///< no key is farther after its release
  Tick s_ = 0, since_ = 0, until_ = 0, horizon_ = 0, last_late_ = 0, settled_by_ = 0;
  bool known_all_ = false;
  std::int64_t walked_ = 0;
  std::vector<Job> jobs_;
  std::vector<std::int64_t> first_;      ///< [xnode] activation that index_ begins with
  std::vector<std::vector<int>> index_;  ///< [xnode] jobs
  std::vector<OnXpu> by_xpu_;
  std::vector<int> equals_;
  std::priority_queue<Next, std::vector<Next>, std::greater<>> ready_;
};

}  // namespace xauto::solver::keys::handover

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
  Walk(const HandoverInput& in, int domain);

  /// t is in [since, until], S is after all of the first table's releases. False: not settled within
  /// `most` jobs.
  bool run(Tick s, Tick since, Tick until, std::int64_t most);
  /// From S on.
  [[nodiscard]] Tick settles() const { return settled_by_ - s_; }
  /// Whoever is released later is as the second table says.
  [[nodiscard]] Tick last_late() const { return last_late_; }

  [[nodiscard]] Tick release(int xnode, std::int64_t n) const { return from_.release(xnode, n); }
  /// By when activation n has ended.
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const;
  /// Before which activation n does not start.
  [[nodiscard]] Tick held(int xnode, std::int64_t n) const {
    return alone(xnode, n).held(xnode, n);
  }
  /// After its release, if it has ended by its key.
  [[nodiscard]] std::optional<Tick> key(int xnode, std::int64_t n) const;
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

  void begin(Tick s, Tick since, Tick until);

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
  [[nodiscard]] int find(int xnode, std::int64_t n) const;

  /// The first activation that is not released before `time`.
  [[nodiscard]] std::int64_t from_on(int xnode, Tick time) const {
    const Component& c = p_.components[at(p_.component_of[at(xnode)])];
    return floor_div(time - 1 - c.phase, c.period) + 1;
  }

  /// What the first table would execute from t on: it suffices to know a hyperperiod of it.
  void plan(int xnode);
  void plan_all();
  /// As if all that counts, with keys up to `key`, had begun by then.
  [[nodiscard]] Tick begun_by(const OnXpu& m, Tick key) const;

  /// Activations of the first table that may not have ended.
  void add_before(int xnode);

  int add(int xnode, std::int64_t n, bool second);

  /// All releases before `time`.
  void extend(Tick time);

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

  void count_waits(int x);

  void one_less(int x) {
    if (x < 0 || jobs_[at(x)].walked) return;
    if (--jobs_[at(x)].waits == 0) ready_.push({jobs_[at(x)].key, jobs_[at(x)].release, x});
  }

  /// Those that wait for `x`, as waited_for counts.
  void release_waiting(const Job& x);

  /// j cannot start before z has ended.
  [[nodiscard]] bool waits_for(const Job& j, const Job& z) const;

  /// A(x), and whether that is known to be in time.
  void set_ready(Job& x) const;

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
  void set_work(Job& x) const;

  /// A job that x's XPU may be busy with, and that it does not interrupt.
  struct Blocker {
    int job;
    Tick less;  ///< work of those that it waits for
  };

  /// A(x), its work, and its place among those of its XPU.
  void make_ready(int index);

  static void set_all_end(OnXpu& m, std::size_t from) {
    for (std::size_t d = from; d < m.done.size(); ++d)
      m.done[d].all_end = std::max(m.done[d].ends, d == 0 ? m.done[d].ends : m.done[d - 1].all_end);
  }

  struct Sums;
  /// F(x).
  void visit(int index);

  /// None is late any more: all up to there are walked.
  [[nodiscard]] bool settled() const;

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

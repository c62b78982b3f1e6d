// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/handover.h"

#include <algorithm>
#include <functional>
#include <queue>
#include <tuple>

#include "solver/steady/chains.h"

namespace xauto::solver::steady {
namespace {

/// A walk that is not settled after so many hyperperiods, or jobs, never is, for us.
constexpr int kMostHyperperiods = 40;
[[nodiscard]] std::int64_t most_of_walk(const Domain& domain) {
  return 10'000 + 4 * domain.jobs;
}

/// Walks the jobs of one domain around one S.
class Walk {
 public:
  Walk(const HandoverInput& in, int domain)
      : in_(in), p_(in.now), domain_(in.now.domains[at(domain)]), by_xpu_(at(p_.num_xpus)) {
    first_.assign(at(p_.num_xnodes), 0);
    index_.resize(at(p_.num_xnodes));
    for (const int i : domain_.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n)
        deepest_ = std::max({deepest_, in.from.d[p_.slot_of(i, n)], in.to.d[p_.slot_of(i, n)]});
  }

  /// t is in [since, until], S is after all of the first table's releases. False: not settled within
  /// `most` jobs.
  bool run(Tick s, Tick since, Tick until, std::int64_t most) {
    begin(s, since, until);
    most = std::min(most, walked_ + most_of_walk(domain_));
    for (const int i : domain_.xnodes) add_before(i);
    plan_all();
    settled_by_ = last_late_ + 2 * deepest_ + domain_.hyper;
    extend(s + deepest_ + domain_.hyper);
    while (!settled()) {
      if (horizon_ > s + kMostHyperperiods * domain_.hyper + 4 * deepest_ || walked_ > most)
        return false;
      if (ready_.empty() || jobs_[at(ready_.top().job)].key > horizon_) {
        extend(horizon_ + domain_.hyper);
        continue;
      }
      // Of equal keys it is known first by when all of them are ready: else the one that comes later
      // would count as if it might be ready at any time, again and again.
      const Tick key = jobs_[at(ready_.top().job)].key;
      equals_.clear();
      for (; !ready_.empty() && jobs_[at(ready_.top().job)].key == key; ready_.pop())
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

  [[nodiscard]] Tick release(int xnode, std::int64_t n) const {
    const Component& c = p_.components[at(p_.component_of[at(xnode)])];
    return c.phase + n * c.period;
  }
  /// By when activation n has ended.
  [[nodiscard]] Tick ends(int xnode, std::int64_t n) const {
    const int x = find(xnode, n);
    if (x >= 0 && jobs_[at(x)].walked) return jobs_[at(x)].ends;
    const Tick at_release = release(xnode, n);
    return at_release + windows(at_release).d[p_.slot_of(xnode, n)];
  }
  /// Before which activation n does not start.
  [[nodiscard]] Tick held(int xnode, std::int64_t n) const {
    const Tick at_release = release(xnode, n);
    return at_release + windows(at_release).hold[p_.slot_of(xnode, n)];
  }
  [[nodiscard]] Tick most_hold(int xnode) const {
    Tick most = 0;
    for (int n = 0; n < p_.jobs[at(xnode)]; ++n)
      most =
          std::max({most, in_.from.hold[p_.slot_of(xnode, n)], in_.to.hold[p_.slot_of(xnode, n)]});
    return most;
  }

 private:
  struct Job {
    int xnode, xpu;
    std::int64_t n;
    Tick release, key, starts;  ///< starts: not before
    Tick wcet;
    bool second, walked = false;
    int waits = 0;  ///< for so many that are not walked
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
    Tick key, work;
    Tick begun;  ///< least key less all work with keys up to it, of those up to here
  };
  static constexpr Tick kNotYet = kMostTicks * 1024;  ///< its end is not known yet
  struct OnXpu {
    std::vector<int> by_key;  ///< all, the walked ones too
    std::size_t first = 0;    ///< all before it are walked
    std::vector<Done> done;   ///< by `ready`
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

  [[nodiscard]] const Windows& windows(Tick release) const {
    return release < s_ ? in_.from : in_.to;
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
      const Tick key = release(xnode, n) + in_.from.d[p_.slot_of(xnode, n)];
      if (key <= s_ + domain_.hyper) by_xpu_[at(xpu)].plan.push_back({key, p_.wcet(xnode, xpu), 0});
    }
  }
  void plan_all() {
    for (const int i : domain_.xnodes) plan(i);
    for (OnXpu& m : by_xpu_) {
      std::sort(m.plan.begin(), m.plan.end(),
                [](const Planned& a, const Planned& b) { return a.key < b.key; });
      Tick work = 0;
      for (std::size_t k = 0; k < m.plan.size(); ++k) {
        work += m.plan[k].work;
        m.plan[k].begun = m.plan[k].key - work;
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
    while (release(xnode, n - 1) + in_.from.d[p_.slot_of(xnode, n - 1)] >= until_) --n;
    first_[at(xnode)] = n;
    for (; n < end; ++n) {
      const int x = add(xnode, n, false);
      last_late_ = std::max(last_late_, jobs_[at(x)].key);
    }
  }

  int add(int xnode, std::int64_t n, bool second) {
    const Tick released = release(xnode, n);
    const Windows& w = second ? in_.to : in_.from;
    const std::size_t slot = p_.slot_of(xnode, n);
    const int xpu = second ? in_.to_xpu[at(xnode)] : in_.from_xpu[at(xnode)];
    Job job{xnode, xpu, n, released, released + w.d[slot], released + w.e[slot], 0, second};
    job.wcet = (second ? in_.then : in_.both).wcet(xnode, xpu);
    const auto x = static_cast<int>(jobs_.size());
    jobs_.push_back(job);
    index_[at(xnode)].push_back(x);
    by_xpu_[at(xpu)].by_key.push_back(x);
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
    for (const Link& link : p_.pred[at(x.xnode)])
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
    for (const Link& link : p_.succ[at(x.xnode)]) one_less(find(link.xnode, x.n));
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

  void set_ready(Job& x) const {
    const bool root = p_.root[at(x.xnode)] != 0;
    Tick ready = x.release + (root ? p_.root_ready[at(x.xnode)] : 0);
    const Windows& w = x.second ? in_.to : in_.from;
    const std::vector<int>& xpu = x.second ? in_.to_xpu : in_.from_xpu;
    const Problem& of_table = x.second ? in_.then : in_.now;  // it may have a message less
    ready = std::max(ready, x.release + w.hold[p_.slot_of(x.xnode, x.n)]);
    for (const Link& link : of_table.pred[at(x.xnode)])
      ready = std::max(ready, ends(link.xnode, x.n) +
                                  of_table.transfer(link, xpu[at(link.xnode)], xpu[at(x.xnode)]));
    if (const int u = find(x.xnode, x.n - 1); u >= 0) {
      const Job& last = jobs_[at(u)];
      const bool ordered = last.xpu == x.xpu && last.key <= x.key;
      ready = std::max(ready, ordered ? last.ready : last.ends);
    }
    const int module = p_.module_of[at(x.xnode)];
    if (module >= 0 && p_.entry[at(x.xnode)] != 0) {
      const Module& m = p_.modules[at(module)];
      if (m.in_flight < kMillion)
        for (const int i : m.xnodes) ready = std::max(ready, ends(i, x.n - m.in_flight));
    }
    x.ready = ready;
  }

  /// Jobs of its XPU with larger keys that may have started before `time`, and do not wait for x.
  template <class Each>
  void larger(const Job& x, Tick time, Each each) const {
    const std::vector<int>& by_key = by_xpu_[at(x.xpu)].by_key;
    auto j = std::upper_bound(by_key.begin(), by_key.end(), x.key,
                              [&](Tick key, int job) { return key < jobs_[at(job)].key; });
    for (; j != by_key.end() && jobs_[at(*j)].key < time + deepest_; ++j)
      if (jobs_[at(*j)].starts < time && !waits_for(jobs_[at(*j)], x)) each(*j);
  }

  void set_work(Job& x) const {
    x.work = x.wcet;
    const Tick cost = p_.preempt[at(x.xpu)];
    if (p_.preemptive[at(x.xpu)] == 0 || cost == 0) return;
    bool preempts = false;
    larger(x, x.ready, [&](int j) { preempts |= jobs_[at(j)].xnode != x.xnode; });
    if (preempts) x.work += cost;
  }

  /// A job that x's XPU may be busy with, and that it does not interrupt.
  struct Blocker {
    int job;
    Tick less;  ///< work of those that it waits for
  };

  /// A(x), its work, and its place among those of its XPU.
  void make_ready(int index) {
    set_ready(jobs_[at(index)]);
    const Tick last = std::max(jobs_[at(index)].ready, jobs_[at(index)].key);
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
    const bool blocks = p_.preemptive[at(x.xpu)] == 0;
    std::vector<Blocker> blockers;
    if (blocks) larger(x, std::max(x.ready, until_), [&](int j) { blockers.push_back({j, 0}); });
    const auto pass = [&](int z) {
      for (Blocker& b : blockers)
        if (waits_for(jobs_[at(b.job)], jobs_[at(z)])) b.less += jobs_[at(z)].work;
    };
    const auto blocked = [&](Tick s) {
      Tick most = 0;
      for (const Blocker& b : blockers)
        if (jobs_[at(b.job)].starts < s) most = std::max(most, jobs_[at(b.job)].wcet - b.less);
      return most;
    };
    // Not walked, and not less urgent: in all sums.
    Tick sum = 0;
    for (std::size_t k = m.first; k < m.by_key.size() && jobs_[at(m.by_key[k])].key <= x.key; ++k) {
      Job& z = jobs_[at(m.by_key[k])];
      if (z.walked) continue;
      z.work = z.wcet + (blocks ? 0 : p_.preempt[at(x.xpu)]);
      sum += z.work;
      pass(m.by_key[k]);
    }
    Tick ends = x.ready + x.work;
    bool all = true;  // the rest counts
    std::size_t k = m.done.size();
    while (k > 0 && m.done[k - 1].ready > since_) {
      const Tick s = m.done[k - 1].ready;
      for (; k > 0 && m.done[k - 1].ready == s; --k) {
        if (jobs_[at(m.done[k - 1].job)].key > x.key) continue;  // walked before: x waited for it
        sum += m.done[k - 1].work;
        if (blocks) pass(m.done[k - 1].job);
      }
      if (s > x.ready) continue;
      ends = std::max(ends, s + sum + blocked(s));
      // What is ready earlier has ended by s: then its work fits between, and an earlier s gives no
      // more, nor does t (its F is at least its own first s, or begun_by, and all of that work).
      if (s >= until_ && (k == 0 || m.done[k - 1].all_end <= s)) {
        all = false;
        break;
      }
    }
    if (all) {
      for (; k > 0; --k) {
        if (jobs_[at(m.done[k - 1].job)].key > x.key) continue;
        sum += m.done[k - 1].work;
        if (blocks) pass(m.done[k - 1].job);
      }
      ends = std::max(ends, begun_by(m, x.key) + sum + blocked(until_));
    }
    x.ends = ends;
    std::size_t mine = m.done.size();
    while (m.done[--mine].job != index) {
    }
    m.done[mine].ends = ends;
    set_all_end(m, mine);
    while (m.first < m.by_key.size() && jobs_[at(m.by_key[m.first])].walked) ++m.first;
    const bool late =
        !x.second || x.ends > x.key || x.ready > x.release + in_.to.a[p_.slot_of(x.xnode, x.n)];
    if (late) {
      last_late_ = std::max({last_late_, x.key, x.ready, x.ends});
      settled_by_ = last_late_ + 2 * deepest_ + domain_.hyper;
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
  Tick deepest_ = 0;
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

/// The way of release k, as chains.h follows it, with what the walk knows.
Tick follow(const Problem& p, const Chain& chain, const Path& path, const Walk& walk,
            std::int64_t k) {
  const auto leaves = [&](std::size_t next) {
    return next < path.samples.size() ? p.samples[at(path.samples[next])].first : chain.to;
  };
  const Component& c = p.components[at(p.component_of[at(leaves(0))])];
  const Tick begin = walk.release(leaves(0), k) - c.phase + chain.offset;
  std::int64_t n = k;
  for (std::size_t next = 0;; ++next) {
    const Tick known = walk.ends(leaves(next), n);
    if (next == path.samples.size()) return known - begin;
    const int v = p.samples[at(path.samples[next])].second;
    const Component& cv = p.components[at(p.component_of[at(v)])];
    n = floor_div(known - walk.most_hold(v) - cv.phase, cv.period);
    while (walk.held(v, n) < known) ++n;
  }
}

/// Why nothing follows for the domain; empty: it does.
std::string refuses(const HandoverInput& in, int d) {
  const Problem& p = in.now;
  const Domain& domain = p.domains[at(d)];
  const std::string clock = "clock '" + p.clock_name[at(domain.clock)] + "' ";
  if (p.any_urgent) return "releases may be urgent";
  if (domain.part) return clock + "has too long a hyperperiod";
  if (domain.ppm != 0) return clock + "has a tolerance";
  std::vector<char> mine(at(p.num_xpus), 0);
  for (const int i : domain.xnodes) mine[at(in.from_xpu[at(i)])] = mine[at(in.to_xpu[at(i)])] = 1;
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const int m : {in.from_xpu[at(i)], in.to_xpu[at(i)]})
      if (p.domain_of(i) != d && mine[at(m)] != 0)
        return clock + "shares " + p.xpu_name[at(m)] + " with another one";
  return {};
}

/// Nominal releases of a hyperperiod, each once.
std::vector<Tick> releases(const Problem& p, const Domain& domain) {
  std::vector<Tick> all;
  for (const int c : domain.components)
    for (int n = 0; n < p.components[at(c)].jobs; ++n)
      all.push_back((p.components[at(c)].phase + n * p.components[at(c)].period) % domain.hyper);
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  return all;
}

/// Where t may be, in pieces: no key of the first table is inside of one.
std::vector<Tick> pieces(const HandoverInput& in, const Domain& domain, Tick since, Tick s) {
  const Problem& p = in.now;
  std::vector<Tick> ends = {since, s};
  for (const int i : domain.xnodes) {
    const Component& c = p.components[at(p.component_of[at(i)])];
    for (std::int64_t n = floor_div(s - 1 - c.phase, c.period);; --n) {
      const Tick key = c.phase + n * c.period + in.from.d[p.slot_of(i, n)];
      if (key <= since) break;
      if (key < s) ends.push_back(key);
    }
  }
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  return ends;
}

}  // namespace

HandoverBound bound_handover(const HandoverInput& in, std::int64_t most_jobs, const Until& until) {
  const Problem& p = in.now;
  HandoverBound bound;
  std::vector<Tick> from, to;
  for (const Chain& chain : p.chains) {
    from.push_back(worst_case(p, chain, in.from));
    to.push_back(worst_case(p, chain, in.to));
  }
  bound.worst.assign(p.chains.size(), kNoTick);
  // A chain's domain; -1: it passes through several.
  std::vector<int> home;
  for (const Chain& chain : p.chains) {
    int d = p.domain_of(chain.to);
    for (const Path& path : chain.paths)
      for (const int s : path.samples)
        if (p.domain_of(p.samples[at(s)].first) != d || p.domain_of(p.samples[at(s)].second) != d)
          d = -1;
    home.push_back(d);
    if (d < 0) bound.why_not.push_back("chain '" + chain.name + "' passes through several clocks");
  }
  for (int d = 0; d < static_cast<int>(p.domains.size()); ++d) {
    const Domain& domain = p.domains[at(d)];
    if (std::string why = refuses(in, d); !why.empty()) {
      bound.why_not.push_back(std::move(why));
      continue;
    }
    std::vector<int> chains;
    for (std::size_t k = 0; k < home.size(); ++k)
      if (home[k] == d) chains.push_back(static_cast<int>(k));
    for (const int k : chains) bound.worst[at(k)] = std::max(from[at(k)], to[at(k)]);
    Walk walk(in, d);
    const std::vector<Tick> at_release = releases(p, domain);
    Tick settles = 0;
    bool follows = true;
    for (std::size_t r = 0; r < at_release.size() && follows; ++r) {
      const Tick s = at_release[r];
      const Tick last = r > 0 ? at_release[r - 1] : at_release.back() - domain.hyper;
      const std::vector<Tick> ends = pieces(in, domain, last - in.notice, s);
      for (std::size_t e = 0; e + 1 < ends.size() && follows; ++e) {
        follows = walk.run(s, ends[e], ends[e + 1], most_jobs) && !until.over();
        if (!follows) break;
        settles = std::max(settles, walk.settles());
        for (const int c : chains) {
          const Chain& chain = p.chains[at(c)];
          for (const Path& path : chain.paths) {
            const int u = path.samples.empty() ? chain.to : p.samples[at(path.samples[0])].first;
            const Component& of = p.components[at(p.component_of[at(u)])];
            std::int64_t k = floor_div(ends[e] - from[at(c)] - of.phase, of.period) - 1;
            for (; of.phase + k * of.period <= walk.last_late(); ++k)
              bound.worst[at(c)] = std::max(bound.worst[at(c)], follow(p, chain, path, walk, k));
          }
        }
      }
    }
    if (follows) {
      bound.settles = std::max(bound.settles, settles);
      continue;
    }
    bound.why_not.push_back("clock '" + p.clock_name[at(domain.clock)] +
                            "' was not seen to settle, as far as jobs were looked at");
    for (const int k : chains) bound.worst[at(k)] = kNoTick;
  }
  return bound;
}

}  // namespace xauto::solver::steady

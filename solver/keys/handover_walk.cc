// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/handover_walk.h"

namespace xauto::solver::keys::handover {

Walk::Walk(const HandoverInput& in, int domain)
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

bool Walk::run(Tick s, Tick since, Tick until, std::int64_t most) {
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

Tick Walk::ends(int xnode, std::int64_t n) const {
  const int x = find(xnode, n);
  if (x >= 0 && jobs_[at(x)].walked) return jobs_[at(x)].ends;
  return alone(xnode, n).ends(xnode, n);
}

std::optional<Tick> Walk::key(int xnode, std::int64_t n) const {
  const int x = find(xnode, n);
  if (x >= 0 && jobs_[at(x)].walked && !jobs_[at(x)].clean) return std::nullopt;
  return alone(xnode, n).key(xnode, n);
}

void Walk::begin(Tick s, Tick since, Tick until) {
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

int Walk::find(int xnode, std::int64_t n) const {
  const auto& index = index_[at(xnode)];
  const std::int64_t k = n - first_[at(xnode)];
  if (k < 0 || k >= static_cast<std::int64_t>(index.size())) return -1;
  return index[static_cast<std::size_t>(k)];
}

void Walk::plan(int xnode) {
  const int xpu = in_.from_xpu[at(xnode)];
  for (std::int64_t n = first_[at(xnode)]; release(xnode, n) < s_ + domain_.hyper; ++n) {
    const Tick d = in_.from.d[p_.slot_of(xnode, n)], key = release(xnode, n) + d;
    if (key <= s_ + domain_.hyper)
      by_xpu_[at(xpu)].plan.push_back(
          {key - blur(d), key + blur(d), least_of_clock(p_.wcet(xnode, xpu), ppm_)});
  }
}

void Walk::plan_all() {
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

Tick Walk::begun_by(const OnXpu& m, Tick key) const {
  const auto next = std::upper_bound(m.plan.begin(), m.plan.end(), key,
                                     [](Tick k, const Planned& p) { return k < p.key; });
  return next == m.plan.begin() ? until_ : std::min(until_, (next - 1)->begun);
}

void Walk::add_before(int xnode) {
  const std::int64_t end = from_on(xnode, s_);
  std::int64_t n = end;
  while (from_.ends(xnode, n - 1) >= until_) --n;
  first_[at(xnode)] = n;
  for (; n < end; ++n) {
    const int x = add(xnode, n, false);
    last_late_ = std::max(last_late_, latest_key(jobs_[at(x)]));
  }
}

int Walk::add(int xnode, std::int64_t n, bool second) {
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

void Walk::extend(Tick time) {
  const std::size_t known = jobs_.size();
  for (const int i : domain_.xnodes)
    for (std::int64_t n = std::max(first_[at(i)] + static_cast<std::int64_t>(index_[at(i)].size()),
                                   from_on(i, s_));
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

void Walk::count_waits(int x) {
  jobs_[at(x)].waits = 0;
  waited_for(jobs_[at(x)], [&](int u) { jobs_[at(x)].waits += jobs_[at(u)].walked ? 0 : 1; });
  if (jobs_[at(x)].waits == 0) ready_.push({jobs_[at(x)].key, jobs_[at(x)].release, x});
}

void Walk::release_waiting(const Job& x) {
  for (const EdgeEnd& link : p_.succ[at(x.xnode)]) one_less(find(link.xnode, x.n));
  one_less(find(x.xnode, x.n + 1));
  const int module = p_.module_of[at(x.xnode)];
  if (module < 0) return;
  const Module& m = p_.modules[at(module)];
  if (m.in_flight >= kMillion) return;
  for (const int e : m.entries) one_less(find(e, x.n + m.in_flight));
}

bool Walk::waits_for(const Job& j, const Job& z) const {
  if (p_.component_of[at(j.xnode)] != p_.component_of[at(z.xnode)]) return false;
  if (j.xnode == z.xnode) return j.n > z.n;
  if (j.n >= z.n && p_.before(z.xnode, j.xnode)) return true;
  const int module = p_.module_of[at(j.xnode)];
  return module >= 0 && module == p_.module_of[at(z.xnode)] &&
         j.n - z.n >= p_.modules[at(module)].in_flight;
}

void Walk::set_ready(Job& x) const {
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

void Walk::set_work(Job& x) const {
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

void Walk::make_ready(int index) {
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

/// The sums that F(x) is the largest of: for each s, the work of what is ready from then on.
struct Walk::Sums {
  const Walk& walk;
  Job& x;
  OnXpu& m;
  const bool blocks;  ///< where not any number may have started, whoever has counts as the last
  const Tick cost;    ///< of a preemption
  std::vector<Blocker> blockers = {};
  Tick sum = 0;
  Tick ends = 0;  ///< the largest so far
  /// What q's certificate says of x holds for a sum of nothing but jobs of q that are ready in time.
  bool certified = true;
  Tick opens = kNotYet;      ///< the first of their windows, at the earliest
  Tick least_key = kNotYet;  ///< of them
  std::size_t left = 0;      ///< of `m.done`: those up to there are not in the sum yet

  Sums(const Walk& of, Job& job, OnXpu& xpu)
      : walk(of),
        x(job),
        m(xpu),
        blocks(of.p_.levels[at(job.xpu)] != kAnyLevels),
        cost(of.p_.preemptive[at(job.xpu)] == 0
                 ? 0
                 : in_fast_time(of.p_.preempt[at(job.xpu)], of.ppm_)),
        ends(job.ready + job.work),
        left(xpu.done.size()) {
    if (blocks)
      walk.larger(x, std::max(x.ready, walk.until_), [&](int j) { blockers.push_back({j, 0}); });
    x.clean = x.on_time;
  }
  [[nodiscard]] const Job& job(int z) const { return walk.jobs_[at(z)]; }
  [[nodiscard]] bool may_be_first(const Job& z) const { return earliest_key(z) <= latest_key(x); }
  void pass(int z) {
    for (Blocker& b : blockers)
      if (walk.waits_for(job(b.job), job(z))) b.less += job(z).work;
  }
  [[nodiscard]] Tick blocked(Tick s) const {
    Tick most = 0;
    for (const Blocker& b : blockers)
      if (job(b.job).starts < s) most = std::max(most, job(b.job).wcet + cost - b.less);
    return most;
  }
  /// The second table's certificate does not know jobs of the first one: who blocks x at s, or is there to
  /// be preempted, at a cost, by what comes from s on.
  [[nodiscard]] bool meets_first(Tick s) const {
    if (!blocks && cost == 0) return false;
    return std::any_of(m.of_first.begin(), m.of_first.end(), [&](int j) {
      const Job& v = job(j);
      if (blocks && v.starts < s && latest_key(v) > earliest_key(x)) return true;
      return cost > 0 && (!v.visited || v.ends > s) && latest_key(v) > least_key;
    });
  }
  void sum_is(Tick by, bool of_q) {
    ends = std::max(ends, by);
    x.clean = x.clean && (of_q || by <= earliest_key(x));
  }

  /// Not walked, and not less urgent: in all sums.
  void add_not_walked(std::vector<Job>& jobs) {
    for (std::size_t k = m.first;
         k < m.by_key.size() && job(m.by_key[k]).key <= latest_key(x) + walk.blur_; ++k) {
      Job& z = jobs[at(m.by_key[k])];
      if (z.walked || !may_be_first(z)) continue;
      z.work = z.wcet + cost;
      sum += z.work;
      certified = false;
      pass(m.by_key[k]);
    }
  }
  /// What is ready at `s`, the latest instant at which something is that is not in the sum.
  void add_ready_at(Tick s) {
    for (; left > 0 && m.done[left - 1].ready == s; --left) {
      const Job& z = job(m.done[left - 1].job);
      if (!may_be_first(z)) continue;  // walked before: x waited for it
      sum += m.done[left - 1].work;
      certified = certified && z.on_time;
      if (z.on_time) opens = std::min(opens, walk.earliest_ready(z));
      least_key = std::min(least_key, earliest_key(z));
      if (blocks) pass(m.done[left - 1].job);
    }
  }
  /// Back from the latest s. False: what is left gives no more.
  bool add_walked() {
    while (left > 0 && m.done[left - 1].ready > walk.since_) {
      const Tick s = m.done[left - 1].ready;
      add_ready_at(s);
      if (s > x.ready) continue;
      sum_is(s + sum + blocked(s), certified && !meets_first(s));
      // What is ready earlier has ended by s: then its work fits between, and an earlier s gives no
      // more, nor does t (its F is at least its own first s, or begun_by, and all of that work). But
      // what q's certificate says needs that it has ended before the first window opens.
      if (s < walk.until_) continue;
      const Tick ended = left == 0 ? -kNotYet : m.done[left - 1].all_end;
      const bool goes_on = x.clean && s + sum + blocked(s) > earliest_key(x) && ended > opens;
      if (ended <= s && !goes_on) return false;
    }
    return true;
  }
  void add_rest() {
    for (; left > 0; --left) {
      if (!may_be_first(job(m.done[left - 1].job))) continue;
      sum += m.done[left - 1].work;
      if (blocks) pass(m.done[left - 1].job);
    }
    sum_is(walk.begun_by(m, latest_key(x)) + sum + blocked(walk.until_), false);
  }
};

void Walk::visit(int index) {
  Job& x = jobs_[at(index)];
  OnXpu& m = by_xpu_[at(x.xpu)];
  Sums sums(*this, x, m);
  sums.add_not_walked(jobs_);
  if (sums.add_walked()) sums.add_rest();
  x.ends = x.clean ? std::min(sums.ends, latest_key(x)) : sums.ends;
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

bool Walk::settled() const {
  if (horizon_ <= settled_by_) return false;
  return std::all_of(by_xpu_.begin(), by_xpu_.end(), [&](const OnXpu& m) {
    return m.first == m.by_key.size() || jobs_[at(m.by_key[m.first])].key > settled_by_;
  });
}

}  // namespace xauto::solver::keys::handover

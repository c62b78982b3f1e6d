// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/certificate.h"

#include <algorithm>

#include "solver/keys/contention.h"

namespace xauto::solver::keys {
namespace {

bool refuse(std::string* why, std::string what) {
  if (why != nullptr) *why = std::move(what);
  return false;
}

bool sane(const Problem& p, const std::vector<int>& xpu, const Windows& w, std::string* why) {
  for (int i = 0; i < p.num_xnodes; ++i) {
    const auto refuse_it = [&](const std::string& what) {
      return refuse(why, "XNode '" + p.xnode_name[at(i)] + "' " + what);
    };
    const auto& may = p.may_run[at(i)];
    if (std::find(may.begin(), may.end(), xpu[at(i)]) == may.end())
      return refuse_it("may not run where it is");
    const Tick period = p.period_of(i), work = p.wcet(i, xpu[at(i)]);
    const std::int64_t ppm = p.domains[at(p.domain_of(i))].ppm;
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      const std::size_t s = at(p.slot[at(i)] + n);
      const std::size_t next = at(p.slot[at(i)] + (n + 1) % p.jobs[at(i)]);
      if (w.d[s] < 0 || w.d[s] > kMostKey || w.hold[s] < 0)
        return refuse_it("has a key or a hold out of range");
      if (w.a[s] + work > w.d[s]) return refuse_it("has a window shorter than its WCET");
      if (w.d[next] + period - lost_in(period, ppm) < w.d[s])
        return refuse_it("has keys that fall");
      if (w.hold[next] + period - lost_in(period, ppm) < w.hold[s])
        return refuse_it("has holds that fall");
    }
  }
  return true;
}

/// The urgent releases of one component, on one XPU. Which of its activations they are, nobody knows:
/// each XNode has the shortest of its windows, which begins up to `slip` after the earliest. Where
/// windows are deeper than two urgent releases are apart, jobs of two releases may begin at any
/// distance: then all begin at once.
Pattern urgent_pattern(const Problem& p, const Component& c, int m, const std::vector<int>& xpu,
                       const Windows& u, const Charges& charges) {
  Pattern g;
  g.period = c.urgent_every;
  g.once = true;
  Tick earliest = kForever, latest = 0;
  g.ppm = p.domains[at(c.domain)].ppm;
  for (const int i : c.xnodes) {
    if (p.urgent[at(i)] == 0 || xpu[at(i)] != m) continue;
    const std::size_t first = at(p.slot[at(i)]);
    Tick begin = u.a[first], last = begin, length = u.d[first] - begin;
    for (std::size_t s = first; s < first + at(c.jobs); ++s) {
      begin = std::min(begin, u.a[s]);
      last = std::max(last, u.a[s]);
      length = std::min(length, u.d[s] - u.a[s]);
      g.deepest = std::max(g.deepest, u.d[s]);
    }
    g.slip = std::max(g.slip, last - begin);
    const bool pays = charges.urgent_preempts[at(i)] != 0;
    earliest = std::min(earliest, begin);
    latest = std::max(latest, begin);
    g.jobs.push_back({begin, length, p.tested_work(i, m, pays)});
  }
  const bool deep = latest + g.slip - earliest > g.period - lost_in(g.period, g.ppm);
  if (deep) g.slip = 0;
  for (WindowedJob& job : g.jobs) job.arrival = deep ? 0 : job.arrival % g.period;
  return g;
}

/// Of another app's sequence: who preempts a job of this one, or of a third one, pays as well.
Pattern pattern_of(const Problem& p, int m, const OtherSequence& other, Tick own_longest) {
  const Tick longest = p.reserve_pct > 0 ? kForever : std::max(own_longest, other.beside);
  const Tick cost = p.preemptive[at(m)] != 0 ? p.preempt[at(m)] : 0;
  const DemandSequence& s = other.of;
  Pattern g{s.period, s.ppm, s.slip, s.once, 0, {}};
  for (const DemandJob& j : s.jobs) {
    const bool pays = !j.charged && longest > j.key - j.ready;
    g.deepest = std::max(g.deepest, j.key);
    g.jobs.push_back({(j.release + j.ready) % s.period, j.key - j.ready,
                      p.with_reserve(j.work + (pays ? cost : 0))});
  }
  return g;
}

/// Others' jobs on the XPU: patterns, and whom they block.
void add_others(const Problem& p, int m, Tick own_longest, std::vector<Pattern>& patterns,
                std::vector<Blocking>& blocking) {
  const Tick cost = p.preemptive[at(m)] != 0 ? p.preempt[at(m)] : 0;
  for (const OtherSequence& other : p.others[at(m)]) {
    patterns.push_back(pattern_of(p, m, other, own_longest));
    if (p.levels[at(m)] == kAnyLevels) continue;
    for (const DemandJob& j : other.of.jobs)
      blocking.push_back({j.key - j.start, p.with_reserve(j.work + (j.charged ? 0 : cost))});
  }
  // Of many jobs those that matter: none blocks for no longer, and no less, than another one.
  std::sort(blocking.begin(), blocking.end(), [](const Blocking& a, const Blocking& b) {
    return a.until != b.until ? a.until > b.until : a.work > b.work;
  });
  Tick most = 0;
  std::erase_if(blocking, [&](const Blocking& b) {
    const bool less = b.work <= most;
    most = std::max(most, b.work);
    return less;
  });
}

std::string text_of(const Problem& p, const Misfit& misfit) {
  if (misfit.kind == Misfit::Kind::kOverload) return "its work is more than the hyperperiod";
  if (misfit.kind == Misfit::Kind::kPilesUp) return "its work piles up";
  return "XNode '" + p.xnode_name[at(misfit.xnode)] + "' ends after its key";
}

}  // namespace

std::vector<char> shared_xpus(const Problem& p, const std::vector<int>& xpu) {
  std::vector<int> domain(at(p.num_xpus), -1);
  std::vector<char> shared(at(p.num_xpus), 0);
  for (int i = 0; i < p.num_xnodes; ++i) {
    int& d = domain[at(xpu[at(i)])];
    if ((d >= 0 && d != p.domain_of(i)) || p.urgent[at(i)] != 0) shared[at(xpu[at(i)])] = 1;
    d = p.domain_of(i);
  }
  for (int m = 0; m < p.num_xpus; ++m)
    if (domain[at(m)] >= 0 &&
        (!p.others[at(m)].empty() || (p.reserve_pct > 0 && p.levels[at(m)] != kAnyLevels)))
      shared[at(m)] = 1;
  return shared;
}

Tick drift_pad(Tick deepest, std::int64_t ppm) {
  if (ppm == 0) return 0;
  return in_fast_time(in_slow_time(2 * deepest, ppm) - 2 * deepest + 1, ppm);
}

LaidJob laid(const Problem& p, const Windows& w, int i, int n, int m, bool pays, Tick blocked_by,
             Tick pad) {
  const Component& c = p.components[at(p.component_of[at(i)])];
  const Domain& domain = p.domains[at(c.domain)];
  const std::size_t s = at(p.slot[at(i)] + n);
  const Tick arrival = c.phase % domain.hyper + n * c.period + w.a[s];
  const Tick in_round = arrival % domain.hyper;
  return {in_round, in_round + w.d[s] - w.a[s], in_fast_time(p.tested_work(i, m, pays), domain.ppm),
          in_fast_time(blocked_by, domain.ppm) + pad, i};
}

bool shared_fits(const Problem& p, int m, const std::vector<int>& xpu, const Windows& w,
                 const Windows& u, const Charges& charges, Tightest* tightest) {
  // One per domain; of a clock that has been split one per component.
  std::vector<Pattern> patterns(p.domains.size() + p.components.size());
  std::vector<Blocking> blocking;
  Tick own_longest = 0;
  for (int i = 0; i < p.num_xnodes; ++i) {
    if (xpu[at(i)] != m) continue;
    const Component& c = p.components[at(p.component_of[at(i)])];
    const bool part = p.domains[at(c.domain)].part;
    Pattern& g = patterns[part ? p.domains.size() + at(p.component_of[at(i)]) : at(c.domain)];
    g.period = p.domains[at(c.domain)].hyper;
    g.ppm = p.domains[at(c.domain)].ppm;
    Tick longest = 0;  // that it may block: of those that may have started as the last
    for (int n = 0; n < c.jobs; ++n) {
      const std::size_t s = at(p.slot[at(i)] + n);
      const Tick work = p.tested_work(i, m, charges.preempts[s] != 0);
      g.deepest = std::max(g.deepest, w.d[s]);
      own_longest = std::max(own_longest, w.d[s] - w.e[s]);
      longest = std::max(longest, w.d[s] - charges.last_start[s]);
      g.jobs.push_back(
          {(c.phase % g.period + n * c.period + w.a[s]) % g.period, w.d[s] - w.a[s], work});
    }
    if (longest > 0) blocking.push_back({longest, p.with_reserve(work_of_blocker(p, i, m))});
  }
  // None blocks for longer than the job whose place it takes: its e is earlier by no more than its
  // key.
  for (const Component& c : p.components)
    if (c.urgent_source >= 0) patterns.push_back(urgent_pattern(p, c, m, xpu, u, charges));
  add_others(p, m, own_longest, patterns, blocking);
  std::erase_if(patterns, [](const Pattern& g) { return g.jobs.empty(); });
  return demand_fits(patterns, blocking, tightest);
}

bool certify_xpu(const Problem& p, int m, const std::vector<int>& xpu, bool shared,
                 const Windows& w, const Windows& u, const Charges& charges, std::string* why) {
  const std::string name = "XPU '" + p.xpu_name[at(m)] + "': ";
  if (shared)
    return shared_fits(p, m, xpu, w, u, charges) ||
           refuse(why, name + "the demand is above what it can serve");
  int domain = -1;
  Tick deepest = 0;
  for (int i = 0; i < p.num_xnodes; ++i) {
    if (xpu[at(i)] != m) continue;
    domain = p.domain_of(i);
    for (int n = 0; n < p.jobs[at(i)]; ++n) deepest = std::max(deepest, w.d[at(p.slot[at(i)] + n)]);
  }
  if (domain < 0) return true;
  const Tick hyper = p.domains[at(domain)].hyper,
             pad = drift_pad(deepest, p.domains[at(domain)].ppm);
  std::vector<LaidJob> jobs;
  for (int i = 0; i < p.num_xnodes; ++i) {
    if (xpu[at(i)] != m) continue;
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      const std::size_t s = at(p.slot[at(i)] + n);
      jobs.push_back(laid(p, w, i, n, m, charges.preempts[s] != 0, charges.blocked_by[s], pad));
    }
  }
  Misfit misfit;
  return fits_alone(jobs, hyper, &misfit) || refuse(why, name + text_of(p, misfit));
}

bool certify(const Problem& p, const std::vector<int>& xpu, Windows& w, std::string* why,
             const Until& until) {
  w.a.resize(at(p.num_slots));
  for (std::size_t d = 0; d < p.domains.size(); ++d) derive_ready(p, static_cast<int>(d), xpu, w);
  if (p.contended) {
    Problem counted = p;
    count_wcets(counted, xpu, counted_wcets(p, xpu, w));
    counted.contended = false;
    return certify(counted, xpu, w, why, until);
  }
  if (!sane(p, xpu, w, why)) return false;
  Windows u;
  derive_urgent(p, xpu, w, u);
  if (int i = -1; urgent_shortfall(p, xpu, w, u, i) > 0)
    return refuse(why, "XNode '" + p.xnode_name[at(i)] + "' has no room for urgent releases");
  Charges charges;
  charge(p, xpu, w, u, -1, charges);
  const std::vector<char> shared = shared_xpus(p, xpu);
  for (int m = 0; m < p.num_xpus; ++m) {
    if (until.over()) return refuse(why, "the time is over");
    if (!certify_xpu(p, m, xpu, shared[at(m)] != 0, w, u, charges, why)) return false;
  }
  return true;
}

}  // namespace xauto::solver::keys

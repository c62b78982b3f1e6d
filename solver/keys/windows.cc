// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/windows.h"

#include <algorithm>
#include <functional>
#include <map>
#include <utility>

#include "solver/keys/pair.h"

namespace xauto::solver::keys {
namespace {

/// XNodes of one XPU whose phases are known: a domain; of a clock that has been split a component; where releases
/// may be urgent, one XNode.
struct Unit {
  std::vector<int> xnodes;
  /// [depth - 1][slot] the earliest start above depth - 1 others of the unit; kForever: never.
  std::vector<std::vector<Tick>> starts;
  std::vector<Tick> longest;  ///< [depth - 1] largest d - start
};

/// Last starts on one XPU that has `levels`.
class Levels {
 public:
  Levels(const Problem& problem, const Windows& w, const Windows& u, int levels)
      : p_(problem), w_(w), u_(u), levels_(levels) {}

  void set_last_starts(const std::vector<int>& here, std::vector<Tick>& last) {
    for (const int i : here) each(i, [&](std::size_t s) { last[s] = kForever; });
    // Activations of an XNode are one after the other.
    if (static_cast<int>(here.size()) <= levels_) return;
    make_units(here);
    bool waits = false;  // some job, while as many as there are levels have started
    for (const Unit& unit : units_)
      for (const int i : unit.xnodes)
        each(i, [&](std::size_t s) {
          const std::vector<Tick> below = lengths_below(unit, i, s);
          waits = waits || at(levels_) <= below.size();
          if (at(levels_) > below.size() + 1) return;
          Tick length = w_.d[s] - w_.e[s];
          if (levels_ > 1) length = std::min(length, below[at(levels_ - 2)]);
          last[s] = w_.d[s] - length;
        });
    if (waits) return;
    for (const int i : here) each(i, [&](std::size_t s) { last[s] = kForever; });
  }

 private:
  template <typename Act>
  void each(int i, const Act& act) const {
    for (int n = 0; n < p_.jobs[at(i)]; ++n) act(at(p_.slot[at(i)] + n));
  }

  void make_units(const std::vector<int>& here) {
    const bool urgent =
        std::any_of(here.begin(), here.end(), [&](int i) { return p_.urgent[at(i)] != 0; });
    std::map<std::pair<int, int>, Unit> units;
    for (const int i : here) {
      const int domain = p_.domain_of(i);
      const bool part = p_.domains[at(domain)].part;
      units[urgent ? std::pair(-1, i) : std::pair(domain, part ? p_.component_of[at(i)] : -1)]
          .xnodes.push_back(i);
    }
    for (auto& [key, unit] : units) {
      make_starts(unit);
      units_.push_back(std::move(unit));
    }
  }

  ///   above nobody: e;  above one more: max(e, the least start of whom it may start above)
  void make_starts(Unit& unit) const {
    unit.starts.push_back(w_.e);
    while (true) {
      Tick longest = 0;
      for (const int i : unit.xnodes)
        each(i,
             [&](std::size_t s) { longest = std::max(longest, w_.d[s] - unit.starts.back()[s]); });
      if (longest <= 0) break;
      unit.longest.push_back(longest);
      if (unit.longest.size() == std::min(unit.xnodes.size(), at(levels_) + 1)) return;
      std::vector<Tick> next(w_.e.size(), kForever);
      for (const int j : unit.xnodes) {
        const Starts of = starts_of(p_, w_, unit.starts.back(), j);
        for (const int i : unit.xnodes) {
          if (i == j) continue;
          const Pair pair(p_, w_, unit.starts.back(), of, i, j, false);
          for (int n = 0; n < p_.jobs[at(i)]; ++n) {
            const std::size_t s = at(p_.slot[at(i)] + n);
            next[s] = std::min(next[s], std::max(w_.e[s], pair.first(n)));
          }
        }
      }
      unit.starts.push_back(std::move(next));
    }
    unit.starts.pop_back();
  }

  /// The lengths below a job of i, the longest first (docs/keys.md, "Levels"). An urgent job's d - e is
  /// not larger than the ordinary one's.
  [[nodiscard]] std::vector<Tick> lengths_below(const Unit& own, int i, std::size_t s) const {
    std::vector<Tick> lengths;
    for (std::size_t depth = 1; depth < own.starts.size(); ++depth)
      if (own.starts[depth][s] < kForever) lengths.push_back(w_.d[s] - own.starts[depth][s]);
    Tick shortest = w_.d[s] - w_.a[s];
    if (p_.urgent[at(i)] != 0)
      each(i, [&](std::size_t k) { shortest = std::min(shortest, u_.d[k] - u_.a[k]); });
    for (const Unit& other : units_)
      for (const Tick longest : other.longest)
        if (&other != &own && longest > shortest) lengths.push_back(longest);
    std::sort(lengths.begin(), lengths.end(), std::greater<>());
    return lengths;
  }

  const Problem& p_;
  const Windows& w_;
  const Windows& u_;
  int levels_;
  std::vector<Unit> units_;
};

/// Adds to `a` of entries that they wait until their modules have room; of one domain, or, -1, of
/// all urgent ones. Those before them are as in `w`.
void admit(const Problem& p, int domain, const Windows& w, Windows& of) {
  for (const Module& module : p.modules) {
    const Component& component = p.components[at(module.component)];
    if (domain >= 0 ? component.domain != domain : component.urgent_source < 0) continue;
    // So many activations later every job of today is over, in any policy that is looked at.
    if (module.in_flight > kMostTicks / component.period) continue;
    const Tick apart = module.in_flight * component.period;
    const Tick lost = lost_in(apart, p.domains[at(component.domain)].ppm);
    for (int n = 0; n < component.jobs; ++n) {
      Tick last = 0;
      for (const int i : module.xnodes) last = std::max(last, w.d[at(p.slot[at(i)] + n)]);
      const auto admitted = static_cast<std::size_t>((n + module.in_flight) % component.jobs);
      for (const int e : module.entries) {
        if (domain < 0 && p.urgent[at(e)] == 0) continue;
        Tick& a = of.a[at(p.slot[at(e)]) + admitted];
        a = std::max(a, last - apart + lost);
      }
    }
  }
}

/// XNodes of one component with one activation each, whose windows meet those of no other release.
bool meet_in_one_release(const Problem& p, const Windows& w, const std::vector<int>& here) {
  if (here.empty()) return false;
  const int c = p.component_of[at(here.front())];
  const Component& component = p.components[at(c)];
  if (component.jobs != 1 || p.domains[at(component.domain)].ppm != 0) return false;
  Tick least = kForever, most = 0;
  for (const int i : here) {
    const std::size_t s = at(p.slot[at(i)]);
    if (p.component_of[at(i)] != c || w.a[s] > component.period) return false;
    least = std::min(least, w.d[s]);
    most = std::max(most, w.d[s]);
  }
  return most - component.period <= least;
}

/// As charge_pairs, of such: nothing to look at but two windows for each of the many pairs.
void charge_one_release(const Problem& p, const Windows& w, const std::vector<int>& here, int m,
                        bool costs, bool limited, Charges& out) {
  std::vector<Tick> d, e, last;
  for (const int j : here) {
    d.push_back(w.d[at(p.slot[at(j)])]);
    e.push_back(w.e[at(p.slot[at(j)])]);
    last.push_back(out.last_start[at(p.slot[at(j)])]);
  }
  for (const int i : here) {
    const std::size_t s = at(p.slot[at(i)]);
    const auto meets = [&](const std::vector<Tick>& starts, std::size_t k) {
      return d[k] > w.d[s] && starts[k] < w.a[s] && here[k] != i && !p.before(i, here[k]) &&
             !p.before(here[k], i);
    };
    for (std::size_t k = 0; costs && k < here.size() && out.preempts[s] == 0; ++k)
      if (meets(e, k)) out.preempts[s] = 1;
    for (std::size_t k = 0; limited && k < here.size(); ++k)
      if (meets(last, k))
        out.blocked_by[s] = std::max(out.blocked_by[s], work_of_blocker(p, here[k], m));
  }
}

void charge_pairs(const Problem& p, const Windows& w, const std::vector<int>& here, int m,
                  bool costs, bool limited, Charges& out) {
  const bool shared = p.beside_others(m) || std::any_of(here.begin(), here.end(), [&](int i) {
                        return p.domain_of(i) != p.domain_of(here.front());
                      });
  for (const int j : here) {
    const Starts early = costs ? starts_of(p, w, w.e, j) : Starts{};
    const Starts last = limited ? starts_of(p, w, out.last_start, j) : Starts{};
    for (const int i : here) {
      if (i == j) continue;
      const auto slots = [&](const std::vector<Tick>& starts, const Starts& of, const auto& act) {
        const Pair pair(p, w, starts, of, i, j, shared);
        for (int n = 0; n < p.jobs[at(i)]; ++n) act(pair, n, at(p.slot[at(i)] + n));
      };
      if (costs)
        slots(w.e, early, [&](const Pair& pair, int n, std::size_t s) {
          if (out.preempts[s] == 0 && pair.meets(n)) out.preempts[s] = 1;
        });
      const Tick work = work_of_blocker(p, j, m);
      if (limited)
        slots(out.last_start, last, [&](const Pair& pair, int n, std::size_t s) {
          if (work > out.blocked_by[s] && pair.meets(n)) out.blocked_by[s] = work;
        });
    }
  }
}

/// Of others' jobs any may be preempted, in any phase; and with a reserve those of nobody knows whom.
void charge_beside(const Problem& p, int m, const std::vector<int>& here, const Windows& w,
                   const Windows& u, Charges& out) {
  const Tick longest = p.reserve_pct > 0 ? kForever : p.others_longest[at(m)];
  for (const int i : here)
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      const std::size_t s = at(p.slot[at(i)] + n);
      if (longest > w.d[s] - w.a[s]) out.preempts[s] = 1;
      if (p.urgent[at(i)] != 0 && longest > u.d[s] - u.a[s]) out.urgent_preempts[at(i)] = 1;
    }
}

/// Urgent releases and the others, as of two domains.
void charge_urgent(const Problem& p, const std::vector<int>& here, const Windows& w,
                   const Windows& u, Charges& out) {
  for (const int j : here) {
    Tick longest = 0, longest_urgent = 0;
    for (int n = 0; n < p.jobs[at(j)]; ++n) {
      const std::size_t s = at(p.slot[at(j)] + n);
      longest = std::max(longest, w.d[s] - w.e[s]);
      if (p.urgent[at(j)] != 0) longest_urgent = std::max(longest_urgent, u.d[s] - u.e[s]);
    }
    for (const int i : here)
      for (int n = 0; n < p.jobs[at(i)] && i != j; ++n) {
        const std::size_t s = at(p.slot[at(i)] + n);
        if (longest_urgent > w.d[s] - w.a[s]) out.preempts[s] = 1;
        if (p.urgent[at(i)] != 0 && std::max(longest, longest_urgent) > u.d[s] - u.a[s])
          out.urgent_preempts[at(i)] = 1;
      }
  }
}

}  // namespace

Tick lost_in(Tick distance, std::int64_t ppm) {
  return ppm == 0 ? 0 : in_fast_time(distance, ppm) - distance + 1;
}

Windows keys_and_holds(const Problem& p, const Policy& policy) {
  Windows w;
  for (auto* values : {&w.a, &w.d, &w.hold, &w.e}) values->assign(at(p.num_slots), 0);
  for (int i = 0; i < p.num_xnodes; ++i) {
    const Placement& placed = policy.placements[at(i)];
    const std::size_t size = placed.key_us.size();
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      w.d[p.slot_of(i, n)] = placed.key_us[at(n) % size] * p.scale;
      if (!placed.hold_us.empty()) w.hold[p.slot_of(i, n)] = placed.hold_us[at(n) % size] * p.scale;
    }
  }
  return w;
}

void derive_ready(const Problem& p, int domain, const std::vector<int>& xpu, Windows& w) {
  w.e.resize(w.a.size());
  for (const int i : p.domains[at(domain)].xnodes) {
    const Component& component = p.components[at(p.component_of[at(i)])];
    const std::size_t base = at(p.slot[at(i)]);
    const Tick least = p.root[at(i)] != 0 ? p.root_ready[at(i)] : 0;
    for (std::size_t n = 0; n < at(component.jobs); ++n) {
      w.a[base + n] = std::max(least, w.hold[base + n]);
      w.e[base + n] = w.hold[base + n];
    }
    for (const EdgeEnd& link : p.pred[at(i)]) {
      const Tick passes = p.transfer(link, xpu[at(link.xnode)], xpu[at(i)]);
      const std::size_t from = at(p.slot[at(link.xnode)]);
      // Another host's clock may be ahead: nothing is known of when that one starts.
      const bool here = p.one_clock(xpu[at(link.xnode)], xpu[at(i)]);
      for (std::size_t n = 0; n < at(component.jobs); ++n) {
        w.a[base + n] = std::max(w.a[base + n], w.d[from + n] + passes);
        if (here) w.e[base + n] = std::max(w.e[base + n], w.e[from + n]);
      }
    }
  }
  admit(p, domain, w, w);
}

void derive_urgent(const Problem& p, const std::vector<int>& xpu, const Windows& w, Windows& u) {
  u = w;
  if (!p.any_urgent) return;
  for (const Domain& domain : p.domains)
    for (const int i : domain.xnodes) {
      const Component& c = p.components[at(p.component_of[at(i)])];
      if (p.urgent[at(i)] == 0) continue;
      const std::size_t base = at(p.slot[at(i)]);
      const Tick least = p.root[at(i)] != 0 ? p.root_ready[at(i)] : 0;
      const Tick apart = c.period - lost_in(c.period, p.domains[at(c.domain)].ppm);
      for (std::size_t n = 0; n < at(c.jobs); ++n) {
        const std::size_t s = base + n, previous = base + (n == 0 ? at(c.jobs) - 1 : n - 1);
        u.hold[s] = std::max(Tick{0}, w.hold[s] - c.urgent_by);
        u.d[s] = w.d[s] - c.urgent_by;
        u.e[s] = u.hold[s];
        u.a[s] = std::max({least, u.hold[s], w.a[previous] - apart});
        for (const EdgeEnd& link : p.pred[at(i)]) {
          const std::size_t from = at(p.slot[at(link.xnode)]) + n;
          const Tick passes = p.transfer(link, xpu[at(link.xnode)], xpu[at(i)]);
          u.a[s] = std::max(u.a[s], u.d[from] + passes);
          if (p.one_clock(xpu[at(link.xnode)], xpu[at(i)])) u.e[s] = std::max(u.e[s], u.e[from]);
        }
      }
    }
  admit(p, -1, w, u);
}

Tick urgent_shortfall(const Problem& p, const std::vector<int>& xpu, const Windows& w,
                      const Windows& u, int& xnode) {
  Tick most = 0;
  for (int i = 0; i < p.num_xnodes; ++i) {
    if (p.urgent[at(i)] == 0) continue;
    const Component& c = p.components[at(p.component_of[at(i)])];
    const Tick apart = c.period - lost_in(c.period, p.domains[at(c.domain)].ppm);
    const Tick work = p.wcet(i, xpu[at(i)]);
    for (int n = 0; n < c.jobs; ++n) {
      const std::size_t s = p.slot_of(i, n), previous = p.slot_of(i, n - 1);
      const Tick missing = std::max(u.a[s] + work - u.d[s], w.d[previous] - apart - u.d[s]);
      if (missing <= most) continue;
      most = missing;
      xnode = i;
    }
  }
  return most;
}

void charge(const Problem& p, const std::vector<int>& xpu, const Windows& w, const Windows& u,
            int only_xpu, Charges& out) {
  out.preempts.assign(at(p.num_slots), 0);
  out.blocked_by.assign(at(p.num_slots), 0);
  out.last_start.assign(at(p.num_slots), kForever);
  out.urgent_preempts.assign(at(p.num_xnodes), 0);
  std::vector<std::vector<int>> here(at(p.num_xpus));
  for (int i = 0; i < p.num_xnodes; ++i) here[at(xpu[at(i)])].push_back(i);
  for (int m = 0; m < p.num_xpus; ++m) {
    if (only_xpu >= 0 && m != only_xpu) continue;
    const bool limited = p.levels[at(m)] != kAnyLevels;
    const bool costs = p.preemptive[at(m)] != 0 && p.preempt[at(m)] > 0;
    if (!limited && !costs) continue;
    if (limited && !p.beside_others(m))
      Levels(p, w, u, p.levels[at(m)]).set_last_starts(here[at(m)], out.last_start);
    else if (limited)  // who may be below is not looked at: each may be the last
      for (const int i : here[at(m)])
        std::copy_n(w.e.begin() + p.slot[at(i)], p.jobs[at(i)],
                    out.last_start.begin() + p.slot[at(i)]);
    if (meet_in_one_release(p, w, here[at(m)]))
      charge_one_release(p, w, here[at(m)], m, costs, limited, out);
    else
      charge_pairs(p, w, here[at(m)], m, costs, limited, out);
    if (!costs) continue;
    if (p.any_urgent) charge_urgent(p, here[at(m)], w, u, out);
    if (p.beside_others(m)) charge_beside(p, m, here[at(m)], w, u, out);
    // An urgent job takes the place of one that is counted with what it pays.
    for (const int i : here[at(m)])
      if (out.urgent_preempts[at(i)] != 0)
        std::fill_n(out.preempts.begin() + p.slot[at(i)], p.jobs[at(i)], char{1});
  }
}

Tick work_of_blocker(const Problem& p, int xnode, int xpu) {
  return p.wcet(xnode, xpu) + (p.preemptive[at(xpu)] != 0 ? p.preempt[at(xpu)] : 0);
}

}  // namespace xauto::solver::keys

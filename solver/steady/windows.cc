// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/windows.h"

#include <algorithm>

namespace xauto::solver::steady {
namespace {

struct Pair {
  const Problem& p;
  const Windows& w;
  int i, j;
  Tick least_e = 0;  ///< of j
  Tick longest = 0;  ///< largest d - e of j
  Tick deepest = 0;  ///< largest d of j

  bool apart;  ///< their phase is not known

  Pair(const Problem& problem, const Windows& windows, int xnode, int other, bool shared)
      : p(problem),
        w(windows),
        i(xnode),
        j(other),
        apart(shared && p.component_of[at(i)] != p.component_of[at(j)] &&
              p.domains[at(p.domain_of(i))].part) {
    least_e = w.e[at(p.slot[at(j)])];
    for (int m = 0; m < p.jobs[at(j)]; ++m) {
      const std::size_t s = at(p.slot[at(j)] + m);
      least_e = std::min(least_e, w.e[s]);
      longest = std::max(longest, w.d[s] - w.e[s]);
      deepest = std::max(deepest, w.d[s]);
    }
  }

  /// Whether some (j, m) may be running when (i, n) becomes ready, with a larger key.
  [[nodiscard]] bool meets(int n) const {
    const Component& ci = p.components[at(p.component_of[at(i)])];
    const Component& cj = p.components[at(p.component_of[at(j)])];
    const Tick a = w.a[at(p.slot[at(i)] + n)], d = w.d[at(p.slot[at(i)] + n)];
    if (ci.domain != cj.domain || apart) return longest > d - a;
    // A clock that drifts moves releases against each other by up to this within the windows.
    const Tick blur = lost_in(a + d + deepest, p.domains[at(ci.domain)].ppm);
    const Tick release = ci.phase + n * ci.period, ready = release + a + blur;
    // The last activation of j that may have started decides, since d + release does not fall from
    // one activation to the next.
    std::int64_t m = floor_div(ready - 1 - cj.phase - least_e, cj.period);
    // Who waits for whom is of one period and phase: activations of one number belong together.
    if (p.before(i, j)) m = std::min<std::int64_t>(m, n - 1);
    if (&ci == &cj) {
      const int module = p.module_of[at(i)];
      if (module >= 0 && module == p.module_of[at(j)])
        m = std::min(m, n + std::min(p.modules[at(module)].in_flight, kMillion) - 1);
    }
    // At the latest one whose activations have all started: e is not below least_e.
    while (cj.phase + m * cj.period + w.e[p.slot_of(j, m)] >= ready) --m;
    if (m <= n && p.before(j, i)) return false;
    return cj.phase + m * cj.period + w.d[p.slot_of(j, m)] + blur > release + d;
  }
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
  // An urgent job takes the place of one that is counted with what it pays.
  for (const int i : here)
    if (out.urgent_preempts[at(i)] != 0)
      std::fill_n(out.preempts.begin() + p.slot[at(i)], p.jobs[at(i)], char{1});
}

}  // namespace

Tick lost_in(Tick distance, std::int64_t ppm) {
  return ppm == 0 ? 0 : in_fast_time(distance, ppm) - distance + 1;
}

Windows keys_and_holds(const Problem& p, const KeyPolicy& policy) {
  Windows w;
  for (auto* values : {&w.a, &w.d, &w.hold, &w.e}) values->assign(at(p.num_slots), 0);
  for (int i = 0; i < p.num_xnodes; ++i) {
    const KeyPlacement& placed = policy.placements[at(i)];
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
      for (std::size_t n = 0; n < at(component.jobs); ++n) {
        w.a[base + n] = std::max(w.a[base + n], w.d[from + n] + passes);
        w.e[base + n] = std::max(w.e[base + n], w.e[from + n]);
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
          u.e[s] = std::max(u.e[s], u.e[from]);
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
  out.urgent_preempts.assign(at(p.num_xnodes), 0);
  std::vector<std::vector<int>> here(at(p.num_xpus));
  for (int i = 0; i < p.num_xnodes; ++i) here[at(xpu[at(i)])].push_back(i);
  for (int m = 0; m < p.num_xpus; ++m) {
    if (only_xpu >= 0 && m != only_xpu) continue;
    const bool preemptive = p.preemptive[at(m)] != 0;
    if (preemptive && p.preempt[at(m)] == 0) continue;
    const bool shared = std::any_of(here[at(m)].begin(), here[at(m)].end(), [&](int i) {
      return p.domain_of(i) != p.domain_of(here[at(m)].front());
    });
    for (const int i : here[at(m)])
      for (const int j : here[at(m)]) {
        if (i == j) continue;
        const Pair pair(p, w, i, j, shared);
        for (int n = 0; n < p.jobs[at(i)]; ++n) {
          const std::size_t s = at(p.slot[at(i)] + n);
          if (preemptive) {
            if (out.preempts[s] == 0 && pair.meets(n)) out.preempts[s] = 1;
          } else if (p.wcet(j, m) > out.blocked_by[s] && pair.meets(n)) {
            out.blocked_by[s] = p.wcet(j, m);
          }
        }
      }
    if (preemptive && p.any_urgent) charge_urgent(p, here[at(m)], w, u, out);
  }
}

}  // namespace xauto::solver::steady

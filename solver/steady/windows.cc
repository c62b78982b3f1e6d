// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/windows.h"

#include <algorithm>

namespace xauto::solver::steady {
namespace {

struct Pair {
  const Problem& p;
  const Windows& w;

  /// Whether j may be running when i becomes ready, with a larger key.
  [[nodiscard]] bool meets(int i, int j) const {
    const Component& ci = p.components[at(p.component_of[at(i)])];
    const Component& cj = p.components[at(p.component_of[at(j)])];
    if (ci.domain != cj.domain) return across(i, j);
    const bool ordered = &ci == &cj && (p.before(i, j) || p.before(j, i));
    const std::int64_t ppm = p.domains[at(ci.domain)].ppm;
    for (int n = 0; n < ci.jobs; ++n) {
      const Tick a = w.a[at(p.slot[at(i)] + n)], d = w.d[at(p.slot[at(i)] + n)];
      // A clock that drifts moves releases against each other by up to this within the windows.
      const Tick blur = ppm == 0 ? 0
                                 : in_fast_time(a + d + w.d[at(p.slot[at(j)])], ppm) -
                                       (a + d + w.d[at(p.slot[at(j)])]) + 1;
      const Tick release = ci.phase + n * ci.period;
      // The last activation of j released before i is ready: d + release does not fall with n, so
      // that if this one's key is not larger, no earlier one's is.
      std::int64_t m = floor_div(release + a - 1 + blur - cj.phase, cj.period);
      if (ordered && m == n) --m;
      const Tick key_j = cj.phase + m * cj.period + w.d[p.slot_of(j, m)];
      if (key_j + blur > release + d) return true;
    }
    return false;
  }

 private:
  [[nodiscard]] bool across(int i, int j) const {
    Tick longest = 0;
    for (int m = 0; m < p.jobs[at(j)]; ++m) longest = std::max(longest, w.d[at(p.slot[at(j)] + m)]);
    for (int n = 0; n < p.jobs[at(i)]; ++n) {
      const std::size_t s = at(p.slot[at(i)] + n);
      if (longest > w.d[s] - w.a[s]) return true;
    }
    return false;
  }
};

}  // namespace

void derive_ready(const Problem& p, int domain, const std::vector<int>& xpu, Windows& w) {
  for (const int c : p.domains[at(domain)].components) {
    const Component& component = p.components[at(c)];
    for (const int i : component.xnodes) {
      const std::size_t base = at(p.slot[at(i)]);
      const Tick least = p.root[at(i)] != 0 ? p.root_ready[at(i)] : 0;
      for (std::size_t n = 0; n < at(component.jobs); ++n)
        w.a[base + n] = std::max(least, w.hold[base + n]);
      for (const Link& link : p.pred[at(i)]) {
        const Tick passes = p.transfer(link, xpu[at(link.xnode)], xpu[at(i)]);
        const std::size_t from = at(p.slot[at(link.xnode)]);
        for (std::size_t n = 0; n < at(component.jobs); ++n)
          w.a[base + n] = std::max(w.a[base + n], w.d[from + n] + passes);
      }
    }
  }
  for (const Module& module : p.modules) {
    const Component& component = p.components[at(module.component)];
    // So many activations later every job of today is over, in any policy that is looked at.
    if (component.domain != domain || module.in_flight > kMostTicks / component.period) continue;
    for (int n = 0; n < component.jobs; ++n) {
      Tick last = 0;
      for (const int i : module.xnodes) last = std::max(last, w.d[at(p.slot[at(i)] + n)]);
      const auto admitted = static_cast<std::size_t>((n + module.in_flight) % component.jobs);
      for (const int e : module.entries) {
        Tick& a = w.a[at(p.slot[at(e)]) + admitted];
        a = std::max(a, last - module.in_flight * component.period);
      }
    }
  }
}

bool Charges::include(const Charges& other) {
  bool grew = false;
  for (std::size_t i = 0; i < preempts.size(); ++i) {
    if (other.preempts[i] > preempts[i]) {
      preempts[i] = 1;
      grew = true;
    }
    if (other.blocked_by[i] > blocked_by[i]) {
      blocked_by[i] = other.blocked_by[i];
      grew = true;
    }
  }
  return grew;
}

void charge(const Problem& p, const std::vector<int>& xpu, const Windows& w, int only_xpu,
            Charges& out) {
  const Pair pair{p, w};
  std::vector<int> here;
  for (int m = 0; m < p.num_xpus; ++m) {
    if (only_xpu >= 0 && m != only_xpu) continue;
    const bool preemptive = p.preemptive[at(m)] != 0;
    here.clear();
    for (int i = 0; i < p.num_xnodes; ++i)
      if (xpu[at(i)] == m) here.push_back(i);
    for (const int i : here) {
      out.preempts[at(i)] = 0;
      out.blocked_by[at(i)] = 0;
      if (preemptive && p.preempt[at(m)] == 0) continue;
      for (const int j : here) {
        if (i == j) continue;
        if (preemptive) {
          if (out.preempts[at(i)] == 0 && pair.meets(i, j)) out.preempts[at(i)] = 1;
        } else if (p.wcet(j, m) > out.blocked_by[at(i)] && pair.meets(i, j)) {
          out.blocked_by[at(i)] = p.wcet(j, m);
        }
      }
    }
  }
}

}  // namespace xauto::solver::steady

// SPDX-License-Identifier: Apache-2.0
// Pair: whether jobs of two XNodes of one XPU meet so that one preempts the other, or is blocked by it (windows.h).
#pragma once

#include <algorithm>
#include <vector>

#include "solver/keys/problem.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

/// Of XNodes on one XPU, `shared` by several domains.
[[nodiscard]] inline bool are_apart(const Problem& p, int i, int j, bool shared) {
  return p.domain_of(i) != p.domain_of(j) ||
         (shared && p.component_of[at(i)] != p.component_of[at(j)] &&
          p.domains[at(p.domain_of(i))].part);
}

/// When the jobs of an XNode start, as `starts` has it.
struct Starts {
  Tick least = kForever;  ///< or something below; kForever: none starts
  Tick longest = 0;       ///< largest d - start; 0: none starts
  Tick deepest = 0;       ///< largest d
};

[[nodiscard]] inline Starts starts_of(const Problem& p, const Windows& w,
                                      const std::vector<Tick>& starts, int j) {
  Starts of;
  for (int m = 0; m < p.jobs[at(j)]; ++m) {
    const std::size_t s = at(p.slot[at(j)] + m);
    of.least = std::min(of.least, starts[s]);
    of.longest = std::max(of.longest, w.d[s] - starts[s]);
    of.deepest = std::max(of.deepest, w.d[s]);
  }
  return of;
}

/// XNode i against another one of its XPU. `starts`: [slot] before which no job of j has started in the way
/// that is asked for; kForever: never.
struct Pair {
  const Problem& p;
  const Windows& w;
  const std::vector<Tick>& starts;
  const Starts& of;  ///< of j
  int i, j;
  bool apart;  ///< their phase is not known

  Pair(const Problem& problem, const Windows& windows, const std::vector<Tick>& start,
       const Starts& of_other, int xnode, int other, bool shared)
      : p(problem),
        w(windows),
        starts(start),
        of(of_other),
        i(xnode),
        j(other),
        apart(are_apart(problem, xnode, other, shared)) {}

  /// Whether some (j, m) may have started when (i, n) becomes ready, with a larger key.
  [[nodiscard]] bool meets(int n) const { return first(n, true) < kForever; }
  /// The earliest start of such a job, after the release of (i, n); kForever: there is none. `any`: of any one.
  [[nodiscard]] Tick first(int n, bool any = false) const {
    const Component& ci = p.components[at(p.component_of[at(i)])];
    const Component& cj = p.components[at(p.component_of[at(j)])];
    const Tick a = w.a[at(p.slot[at(i)] + n)], d = w.d[at(p.slot[at(i)] + n)];
    if (of.least == kForever) return kForever;
    if (apart) return of.longest > d - a ? d - of.longest : kForever;
    // A clock that drifts moves releases against each other by up to this within the windows.
    const Tick blur = lost_in(a + d + of.deepest, p.domains[at(ci.domain)].ppm);
    const Tick release = ci.phase + n * ci.period, ready = release + a + blur;
    std::int64_t m = floor_div(ready - 1 - cj.phase - of.least, cj.period);
    // Who waits for whom is of one period and phase: activations of one number belong together.
    if (p.before(i, j)) m = std::min<std::int64_t>(m, n - 1);
    if (&ci == &cj) {
      const int module = p.module_of[at(i)];
      if (module >= 0 && module == p.module_of[at(j)])
        m = std::min(m, n + std::min(p.modules[at(module)].in_flight, kMillion) - 1);
    }
    const bool waits = p.before(j, i);
    Tick earliest = kForever;
    // d + release does not fall from one activation to the next.
    for (;; --m) {
      const Tick released = cj.phase + m * cj.period, start = starts[p.slot_of(j, m)];
      if (released + w.d[p.slot_of(j, m)] + blur <= release + d || (waits && m <= n))
        return earliest;
      if (start == kForever || released + start >= ready) continue;
      earliest = std::min(earliest, released + start - blur - release);
      if (any) return earliest;
    }
  }
};

}  // namespace xauto::solver::keys

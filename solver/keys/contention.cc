// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/contention.h"

#include <algorithm>

namespace xauto::solver::keys {
namespace {

const std::vector<LoadedWcet>& stated(const Problem& p, int xnode, int xpu) {
  return p.loaded[at(xnode) * at(p.num_types) + at(p.xpu_type[at(xpu)])];
}

/// From where a job may run to its key, in any release.
struct Hull {
  Tick from, to;
};

Hull hull(const Problem& p, const Windows& w, int i, int n) {
  const Component& c = p.components[at(p.component_of[at(i)])];
  const std::size_t s = p.slot_of(i, n);
  const Tick release = c.phase + n * c.period;
  return {release + std::max(Tick{0}, w.e[s] - p.urgent_by(i)), release + w.d[s]};
}

/// (j, m) never starts before (i, n) has ended.
bool waits(const Problem& p, int i, std::int64_t n, int j, std::int64_t m) {
  if (p.before(i, j) && m >= n) return true;
  const int module = p.module_of[at(i)];
  return module >= 0 && p.module_of[at(j)] == module && m >= n + p.modules[at(module)].in_flight;
}

/// Both of one domain.
bool may_meet(const Problem& p, const Windows& w, int i, int j) {
  const Component& of = p.components[at(p.component_of[at(j)])];
  const std::int64_t ppm = p.domains[at(p.domain_of(i))].ppm;
  Tick longest = 0;
  for (int m = 0; m < of.jobs; ++m) longest = std::max(longest, w.d[p.slot_of(j, m)]);
  for (int n = 0; n < p.jobs[at(i)]; ++n) {
    const Hull one = hull(p, w, i, n);
    // Distances of releases that matter are no longer than both windows; a clock may change them by so much.
    const Tick lost = lost_in(one.to - one.from + longest + w.d[p.slot_of(i, n)], ppm);
    const std::int64_t first = floor_div(one.from - lost - longest - of.phase, of.period);
    for (std::int64_t m = first; of.phase + m * of.period < one.to + lost; ++m) {
      const std::size_t s = p.slot_of(j, m);
      const Tick release = of.phase + m * of.period;
      const Tick from = release + std::max(Tick{0}, w.e[s] - p.urgent_by(j)), to = release + w.d[s];
      if (from < one.to + lost && one.from < to + lost && !waits(p, i, n, j, m) &&
          !waits(p, j, m, i, n))
        return true;
    }
  }
  return false;
}

}  // namespace

std::vector<Tick> least_counted(const Problem& p, const std::vector<int>& xpu) {
  std::vector<Tick> least;
  for (int i = 0; i < p.num_xnodes; ++i) {
    const auto& all = stated(p, i, xpu[at(i)]);
    least.push_back(all.empty() ? p.wcet(i, xpu[at(i)]) : all.front().wcet);
  }
  return least;
}

std::vector<Tick> most_counted(const Problem& p, const std::vector<int>& xpu) {
  std::vector<Tick> most = least_counted(p, xpu);
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const LoadedWcet& one : stated(p, i, xpu[at(i)]))
      most[at(i)] = std::max(most[at(i)], one.wcet);
  return most;
}

std::vector<Tick> counted_wcets(const Problem& p, const std::vector<int>& xpu, const Windows& w) {
  std::vector<Tick> counted;
  if (!p.contended) {
    for (int i = 0; i < p.num_xnodes; ++i) counted.push_back(p.wcet(i, xpu[at(i)]));
    return counted;
  }
  counted = least_counted(p, xpu);
  std::vector<std::vector<int>> here(at(p.num_xpus));
  for (int i = 0; i < p.num_xnodes; ++i) here[at(xpu[at(i)])].push_back(i);
  std::vector<int> loads(at(p.num_types));
  for (int i = 0; i < p.num_xnodes; ++i) {
    const auto& all = stated(p, i, xpu[at(i)]);
    if (all.empty()) continue;
    std::fill(loads.begin(), loads.end(), 0);
    for (int m = 0; m < p.num_xpus; ++m) {
      const std::size_t type = at(p.xpu_type[at(m)]);
      const bool counts =
          m != xpu[at(i)] &&
          std::any_of(all.begin(), all.end(), [&](const auto& of) { return of.load[type] > 0; });
      if (counts && std::any_of(here[at(m)].begin(), here[at(m)].end(), [&](int j) {
            return p.domain_of(j) != p.domain_of(i) || may_meet(p, w, i, j);
          }))
        ++loads[type];
    }
    Tick least = kForever;
    for (const LoadedWcet& one : all) {
      bool covers = true;
      for (std::size_t t = 0; t < loads.size(); ++t) covers = covers && one.load[t] >= loads[t];
      if (covers) least = std::min(least, one.wcet);
    }
    counted[at(i)] = least;
  }
  return counted;
}

void count_wcets(Problem& p, const std::vector<int>& xpu, const std::vector<Tick>& counted) {
  for (int i = 0; i < p.num_xnodes; ++i)
    p.wcet_flat[at(i) * at(p.num_xpus) + at(xpu[at(i)])] = counted[at(i)];
}

}  // namespace xauto::solver::keys

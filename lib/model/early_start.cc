// SPDX-License-Identifier: Apache-2.0
#include "model/early_start.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <map>
#include <numeric>
#include <set>
#include <string>
#include <string_view>

#include "base/index.h"
#include "model/components.h"
#include "model/contention.h"
#include "model/hosts.h"

namespace xauto {
namespace {

/// Entry j of values that repeat.
std::int64_t entry(const std::vector<std::int64_t>& values, std::size_t j) {
  return values.empty() ? 0 : values[j % values.size()];
}

}  // namespace

PlannedStarts planned_starts_us(const AppSpec& app, const Platform& platform,
                                const Policy& policy) {
  const std::size_t n = app.xnodes.size();
  PlannedStarts planned{std::vector<std::vector<std::int64_t>>(n),
                        std::vector<std::vector<std::int64_t>>(n)};
  const auto components = find_components(app);
  if (!components) return planned;
  // Edges, then order, which carries no message.
  std::vector<std::pair<int, int>> waits = app.edges;
  waits.insert(waits.end(), policy.order.begin(), policy.order.end());
  std::vector<std::int64_t> transfer = transfers_us(policy, app, platform);
  transfer.resize(waits.size(), 0);
  std::vector<std::vector<std::size_t>> into(n);
  for (std::size_t e = 0; e < waits.size(); ++e) into[at(waits[e].second)].push_back(e);
  // Of what comes from another host nobody knows how early it may be there.
  const std::vector<int> host = hosts_of(app, platform, policy);
  const std::vector<int> topological = app.topological_order(policy.order);
  // Of urgent releases by how much, and who hears of them.
  std::vector<std::int64_t> sooner(n, 0);
  std::map<std::string_view, std::int64_t> marked;  // [module] what it publishes
  for (const SourceSpec& source : app.sources)
    if (source.urgent && !source.urgent->marked_by.empty())
      marked[source.urgent->marked_by] =
          std::max(marked[source.urgent->marked_by], source.urgent->by_us);
  for (const int i : topological) {
    for (const int s : app.xnodes[at(i)].sources)
      if (const auto& urgent = app.sources[at(s)].urgent; urgent && urgent->marked_by.empty())
        sooner[at(i)] = std::max(sooner[at(i)], urgent->by_us);
    for (const std::size_t e : into[at(i)]) {
      if (e >= app.edges.size()) continue;
      sooner[at(i)] = std::max(sooner[at(i)], sooner[at(waits[e].first)]);
      const std::string& from = app.xnodes[at(waits[e].first)].module;
      if (marked.empty() || app.xnodes[at(i)].module == from) continue;
      if (const auto by = marked.find(from); by != marked.end())
        sooner[at(i)] = std::max(sooner[at(i)], by->second);
    }
  }
  // With holds earlier by `by`, or without any.
  const auto follow = [&](bool held, const std::vector<std::int64_t>& by) {
    std::vector<std::vector<std::int64_t>> starts(n);
    for (const int i : topological) {
      const Placement& placed = policy.placements[at(i)];
      // Sizes divide the activations of a hyperperiod, so what they come round in does, too.
      std::size_t size = std::max<std::size_t>(1, placed.hold_us.size());
      for (const std::size_t e : into[at(i)])
        size = std::lcm(size, starts[at(waits[e].first)].size());
      std::int64_t offset = 0;
      for (const int s : app.xnodes[at(i)].sources)
        offset = std::max(offset, app.sources[at(s)].offset_us -
                                      components->components[at(components->of[at(i)])].offset_us);
      for (std::size_t j = 0; j < size; ++j) {
        std::int64_t start = offset;
        if (held) start = std::max(start, entry(placed.hold_us, j) - by[at(i)]);
        for (const std::size_t e : into[at(i)])
          if (host[at(waits[e].first)] == host[at(i)])
            start = std::max(start, entry(starts[at(waits[e].first)], j) + transfer[e]);
        starts[at(i)].push_back(start);
      }
    }
    return starts;
  };
  const std::vector<std::vector<std::int64_t>> free = follow(false, {});
  planned.ordinary = follow(true, std::vector<std::int64_t>(n, 0));
  planned.urgent = follow(true, sooner);
  for (auto* starts : {&planned.ordinary, &planned.urgent})
    for (std::size_t i = 0; i < n; ++i) {
      std::vector<std::int64_t>& one = (*starts)[i];
      bool delayed = false;
      for (std::size_t j = 0; j < one.size(); ++j) delayed = delayed || one[j] > entry(free[i], j);
      if (!delayed) one.clear();
    }
  return planned;
}

std::vector<std::vector<int>> kept_apart(const AppSpec& app, const Platform& platform,
                                         const Policy& policy) {
  const std::size_t n = app.xnodes.size();
  std::vector<std::vector<int>> apart(n);
  const auto components = find_components(app);
  if (!components || !policy.certified || policy.by_priority()) return apart;
  const auto type = [&](std::size_t i) -> const std::string& {
    return platform.xpus[at(policy.placements[i].xpu)].type;
  };
  std::vector<std::set<std::string, std::less<>>> counts(
      n);  // loads that less than the longest is counted beside
  for (std::size_t i = 0; i < n; ++i)
    if (policy.placements[i].wcet_us.value_or(INT64_MAX) < longest_wcet(app.xnodes[i], type(i)))
      counts[i] = stated_loads(app.xnodes[i], type(i));
  const auto clock = [&](std::size_t i) {
    return components->components[at(components->of[i])].clock;
  };
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t u = 0; u < n; ++u)
      if (policy.placements[i].xpu != policy.placements[u].xpu && clock(i) == clock(u) &&
          (counts[i].contains(type(u)) || counts[u].contains(type(i))))
        apart[i].push_back(static_cast<int>(u));
  return apart;
}

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
#include "model/early_start.h"

#include <algorithm>
#include <numeric>

#include "base/index.h"
#include "model/components.h"

namespace xauto {
namespace {

/// Entry j of values that repeat.
std::int64_t entry(const std::vector<std::int64_t>& values, std::size_t j) {
  return values.empty() ? 0 : values[j % values.size()];
}

}  // namespace

std::vector<std::vector<std::int64_t>> planned_starts_us(const AppSpec& app,
                                                         const Platform& platform,
                                                         const KeyPolicy& policy) {
  const std::size_t n = app.xnodes.size();
  std::vector<std::vector<std::int64_t>> with(n), without(n);
  const auto components = find_components(app);
  if (!components) return with;
  AppSpec both;
  both.xnodes.resize(n);
  both.edges = app.edges;
  both.edges.insert(both.edges.end(), policy.order.begin(), policy.order.end());
  std::vector<std::int64_t> transfer(both.edges.size(), 0);
  const auto type = [&](int i) -> const std::string& {
    return platform.xpus[at(policy.placements[at(i)].xpu)].type;
  };
  for (const TransferSpec& t : app.transfers) {
    const auto [u, v] = app.edges[at(t.edge)];
    if (t.from_type == type(u) && t.to_type == type(v)) transfer[at(t.edge)] = t.transfer_us;
  }
  std::vector<std::vector<std::size_t>> into(n);
  for (std::size_t e = 0; e < both.edges.size(); ++e) into[at(both.edges[e].second)].push_back(e);
  std::vector<char> delayed(n, 0);
  for (const int i : both.topological_order()) {
    const KeyPlacement& placed = policy.placements[at(i)];
    // Sizes divide the activations of a hyperperiod, so what they come round in does, too.
    std::size_t size = std::max<std::size_t>(1, placed.hold_us.size());
    for (const std::size_t e : into[at(i)])
      size = std::lcm(size, std::max<std::size_t>(1, with[at(both.edges[e].first)].size()));
    with[at(i)].assign(size, 0);
    without[at(i)].assign(size, 0);
    std::int64_t offset = 0;
    for (const int s : app.xnodes[at(i)].sources)
      offset = std::max(offset, app.sources[at(s)].offset_us -
                                    components->components[at(components->of[at(i)])].offset_us);
    for (std::size_t j = 0; j < size; ++j) {
      std::int64_t &held = with[at(i)][j], &free = without[at(i)][j];
      free = offset;
      held = std::max(offset, entry(placed.hold_us, j));
      for (const std::size_t e : into[at(i)]) {
        const std::size_t u = at(both.edges[e].first);
        held = std::max(held, entry(with[u], j) + transfer[e]);
        free = std::max(free, entry(without[u], j) + transfer[e]);
      }
      if (held > free) delayed[at(i)] = 1;
    }
  }
  for (std::size_t i = 0; i < n; ++i)
    if (delayed[i] == 0) with[i].clear();
  return with;
}

}  // namespace xauto

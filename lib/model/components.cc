// SPDX-License-Identifier: Apache-2.0
#include "model/components.h"

#include <algorithm>
#include <map>
#include <numeric>

#include "base/index.h"
#include "model/refusal.h"

namespace xauto {
namespace {

/// nullopt: beyond `limit`, which is below 2^62. Both above 0.
std::optional<std::int64_t> lcm(std::int64_t a, std::int64_t b, std::int64_t limit) {
  const __int128 multiple = static_cast<__int128>(a / std::gcd(a, b)) * b;
  if (multiple > limit) return std::nullopt;
  return static_cast<std::int64_t>(multiple);
}

Result<std::int64_t> ticks_per_us(const AppSpec& app) {
  std::int64_t ticks = 1;
  for (std::size_t i = 0; i < app.sources.size(); ++i) {
    const SourceSpec& source = app.sources[i];
    const auto common = lcm(ticks, source.period.den, kMaxTicksPerUs);
    if (!common)
      return fail(ErrorCode::kInvalid,
                  "source " + quoted(source.name) + " (" + source.period.text() +
                      ") and those before it: no time of 1/" + std::to_string(kMaxTicksPerUs) +
                      " us or longer divides all their periods",
                  "/sources/" + std::to_string(i), "round one of the rates, or state period_us");
    ticks = *common;
  }
  return ticks;
}

/// Refuses two sources that cannot release together. `heard` and `other` are theirs.
Status fit(const AppSpec& app, int xnode, int heard, int other, const std::string& where,
           const std::string& hint) {
  const SourceSpec &a = app.sources[at(heard)], &b = app.sources[at(other)];
  if (a.clock == b.clock && a.period == b.period) return {};
  const auto say = [&](const SourceSpec& source) {
    return quoted(source.name) + " (" +
           (a.clock != b.clock ? "clock " + quoted(app.clocks[at(source.clock)].name)
                               : source.period.text()) +
           ")";
  };
  return fail(ErrorCode::kInvalid,
              "XNode " + quoted(app.xnodes[at(xnode)].name) + " joins sources " + say(a) + " and " +
                  say(b) + ": what edges join has one clock and one period",
              where, hint);
}

}  // namespace

// Enough for whole components: along an edge both ends then have the same.
Status check_joins(const AppSpec& app) {
  std::vector<std::vector<std::size_t>> incoming(app.xnodes.size());
  for (std::size_t e = 0; e < app.edges.size(); ++e) incoming[at(app.edges[e].second)].push_back(e);
  std::vector<int> heard(app.xnodes.size(), -1);
  for (const int v : app.topological_order()) {
    const XNodeSpec& x = app.xnodes[at(v)];
    for (const int source : x.sources) {
      if (heard[at(v)] < 0) heard[at(v)] = source;
      XAUTO_TRY(fit(app, v, heard[at(v)], source, "/xnodes/" + std::to_string(v) + "/source",
                    "let an XNode hear of one of them, and sample that XNode"));
    }
    for (const std::size_t e : incoming[at(v)]) {
      const int u = app.edges[e].first;
      if (heard[at(u)] < 0) continue;  // nobody fires it: validate() refuses it, and may come later
      if (heard[at(v)] < 0) heard[at(v)] = heard[at(u)];
      XAUTO_TRY(fit(app, v, heard[at(v)], heard[at(u)], "/edges/" + std::to_string(e),
                    "sample one of them: move the edge to \"samples\""));
    }
  }
  return {};
}

namespace {

/// [xnode] its component, numbered by their least XNodes.
std::vector<int> joined(const AppSpec& app, std::size_t* count) {
  std::vector<int> root(app.xnodes.size());
  std::iota(root.begin(), root.end(), 0);
  const auto find = [&](int x) {
    while (root[at(x)] != x) x = root[at(x)] = root[at(root[at(x)])];
    return x;
  };
  for (const auto& [u, v] : app.edges) root[at(find(u))] = find(v);
  std::vector<int> number(app.xnodes.size(), -1), of;
  int next = 0;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    int& mine = number[at(find(static_cast<int>(i)))];
    if (mine < 0) mine = next++;
    of.push_back(mine);
  }
  *count = at(next);
  return of;
}

Status add_modules(const AppSpec& app, Components& found) {
  std::map<std::string_view, int> index;
  for (std::size_t m = 0; m < app.modules.size(); ++m)
    index.try_emplace(app.modules[m].name, static_cast<int>(m));
  std::map<std::string_view, std::size_t> first;  // module -> its first XNode
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const std::string& module = app.xnodes[i].module;
    const auto [it, added] = first.try_emplace(module, i);
    if (!added && found.of[it->second] != found.of[i])
      return fail(ErrorCode::kInvalid,
                  "module " + quoted(module) + " is in two components: no edges join its XNodes " +
                      quoted(app.xnodes[it->second].name) + " and " + quoted(app.xnodes[i].name),
                  "/xnodes/" + std::to_string(i) + "/module", "make two modules of it");
    if (const auto known = index.find(module); added && known != index.end())
      found.components[at(found.of[i])].modules.push_back(known->second);
  }
  for (Component& component : found.components)
    std::sort(component.modules.begin(), component.modules.end());
  return {};
}

void add_domains(Components& found) {
  std::map<int, std::vector<int>> by_clock;
  for (std::size_t c = 0; c < found.components.size(); ++c)
    by_clock[found.components[c].clock].push_back(static_cast<int>(c));
  for (const auto& [clock, components] : by_clock) {
    Domain domain{clock, components, 1, 0};
    for (const int c : components)
      if (domain.hyperperiod_ticks)
        domain.hyperperiod_ticks = lcm(*domain.hyperperiod_ticks,
                                       found.components[at(c)].period_ticks, kMaxHyperperiodTicks);
    for (const int c : components) {
      Component& component = found.components[at(c)];
      component.domain = static_cast<int>(found.domains.size());
      if (!domain.hyperperiod_ticks) continue;
      component.activations = *domain.hyperperiod_ticks / component.period_ticks;
      std::int64_t jobs = 0;
      if (domain.jobs < 0 ||
          __builtin_mul_overflow(component.activations,
                                 static_cast<std::int64_t>(component.xnodes.size()), &jobs) ||
          __builtin_add_overflow(domain.jobs, jobs, &domain.jobs))
        domain.jobs = -1;
    }
    domain.jobs = std::max<std::int64_t>(domain.jobs, 0);
    found.domains.push_back(std::move(domain));
  }
}

}  // namespace

Result<Components> find_components(const AppSpec& app) {
  Components found;
  XAUTO_ASSIGN(found.ticks_per_us, ticks_per_us(app));
  XAUTO_TRY(check_joins(app));
  std::size_t count = 0;
  found.of = joined(app, &count);
  found.components.resize(count);
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    Component& component = found.components[at(found.of[i])];
    component.xnodes.push_back(static_cast<int>(i));
    component.sources.insert(component.sources.end(), app.xnodes[i].sources.begin(),
                             app.xnodes[i].sources.end());
  }
  for (Component& component : found.components) {
    std::vector<int>& sources = component.sources;
    std::sort(sources.begin(), sources.end());
    sources.erase(std::unique(sources.begin(), sources.end()), sources.end());
    if (sources.empty())
      return fail(
          ErrorCode::kInvalid,
          "XNode " + quoted(app.xnodes[at(component.xnodes.front())].name) + " hears of no source",
          "/xnodes/" + std::to_string(component.xnodes.front()));
    const SourceSpec& one = app.sources[at(sources.front())];
    component.clock = one.clock;
    component.period = one.period;
    component.offset_us = one.offset_us;
    for (const int s : sources)
      component.offset_us = std::min(component.offset_us, app.sources[at(s)].offset_us);
    component.period_ticks = one.period.num * (found.ticks_per_us / one.period.den);
    component.offset_ticks = component.offset_us * found.ticks_per_us;
  }
  XAUTO_TRY(add_modules(app, found));
  add_domains(found);
  return found;
}

}  // namespace xauto

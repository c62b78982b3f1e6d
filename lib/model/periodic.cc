// SPDX-License-Identifier: Apache-2.0
#include "model/periodic.h"

#include <algorithm>
#include <deque>
#include <map>
#include <set>
#include <tuple>
#include <unordered_map>
#include <unordered_set>

#include "base/index.h"
#include "model/components.h"
#include "model/loss.h"
#include "model/refusal.h"

namespace xauto {
namespace {

// ---- who hears of what --------------------------------------------------------------------------

/// Ways from a source to an XNode: along edges, and along samples from one component to another, no
/// component twice.
class Ways {
 public:
  Ways(const AppSpec& app, const Components& components)
      : app_(app), components_(components), succ_(app.successors()), read_by_(app.xnodes.size()) {
    for (const auto& [u, v] : app.samples)
      if (components.of[at(u)] != components.of[at(v)]) read_by_[at(u)].push_back(v);
    roots_.resize(app.sources.size());
    for (std::size_t i = 0; i < app.xnodes.size(); ++i)
      for (const int s : app.xnodes[i].sources) roots_[at(s)].push_back(static_cast<int>(i));
  }

  [[nodiscard]] bool exists(int source, int to) {
    if (source != source_) follow(source);
    if (before_[at(to)] == kUnheard) return false;
    return !returns(to) || exists_without_return(source, to);
  }

 private:
  static constexpr int kUnheard = -2, kRoot = -1;

  /// The ways with the fewest samples, to whatever hears of the source: before_[x] is the XNode
  /// before x. Edges are free, so what they reach comes first.
  void follow(int source) {
    source_ = source;
    before_.assign(app_.xnodes.size(), kUnheard);
    std::deque<std::pair<int, int>> open;  // XNode, the one before it
    for (const int x : roots_[at(source)]) open.emplace_back(x, kRoot);
    while (!open.empty()) {
      const auto [x, before] = open.front();
      open.pop_front();
      if (before_[at(x)] != kUnheard) continue;
      before_[at(x)] = before;
      for (const int s : succ_[at(x)])
        if (before_[at(s)] == kUnheard) open.emplace_front(s, x);
      for (const int s : read_by_[at(x)])
        if (before_[at(s)] == kUnheard) open.emplace_back(s, x);
    }
  }

  /// Whether that way enters a component twice. Then there may be another that does not.
  [[nodiscard]] bool returns(int to) const {
    std::set<int> entered = {components_.of[at(to)]};
    for (int x = to; before_[at(x)] >= 0; x = before_[at(x)]) {
      const int here = components_.of[at(x)], there = components_.of[at(before_[at(x)])];
      if (here != there && !entered.insert(there).second) return true;
    }
    return false;
  }

  /// Component by component, each step to all that it reaches in the next. How many orders of
  /// components there are knows no bound, so the search has one; what it does not find is refused.
  [[nodiscard]] bool exists_without_return(int source, int to) {
    std::map<int, std::vector<int>> entries;
    for (const int x : roots_[at(source)]) entries[components_.of[at(x)]].push_back(x);
    std::vector<char> visited(components_.components.size(), 0);
    std::int64_t budget = 100'000;
    for (const auto& [c, open] : entries)
      if (search(c, open, to, visited, budget, 0)) return true;
    return false;
  }

  bool search(int c, std::vector<int> open, int to, std::vector<char>& visited,
              std::int64_t& budget, int depth) {
    constexpr int kMostSteps = 1000;
    std::set<int> seen(open.begin(), open.end());
    std::map<int, std::vector<int>> next;
    while (!open.empty()) {
      const int x = open.back();
      open.pop_back();
      if (x == to) return true;
      if (--budget < 0 || --total_budget_ < 0) return false;
      for (const int s : succ_[at(x)])
        if (seen.insert(s).second) open.push_back(s);
      for (const int s : read_by_[at(x)])
        if (!visited[at(components_.of[at(s)])]) next[components_.of[at(s)]].push_back(s);
    }
    if (depth >= kMostSteps) return false;
    visited[at(c)] = 1;
    bool found = false;
    for (auto it = next.begin(); it != next.end() && !found && budget > 0; ++it)
      found = it->first != c && search(it->first, it->second, to, visited, budget, depth + 1);
    visited[at(c)] = 0;
    return found;
  }

  const AppSpec& app_;
  const Components& components_;
  std::vector<std::vector<int>> succ_, read_by_, roots_;
  int source_ = -1;
  std::vector<int> before_;  ///< of source_: see follow()
  std::int64_t total_budget_ = 20'000'000;
};

// ---- parts of validate_periodic -----------------------------------------------------------------

Status validate_clocks(const AppSpec& app) {
  if (app.clocks.empty() || app.clocks.front().name != kMainClock)
    return invalid("the first clock is not 'main'", "/clocks");
  XAUTO_TRY(validate_names(app.clocks, "clocks", "clock"));
  for (std::size_t i = 0; i < app.clocks.size(); ++i)
    XAUTO_TRY(
        in_range(app.clocks[i].ppm, 0, kMaxPpm, "a tolerance in ppm", nth("clocks", i) + "/ppm"));
  for (std::size_t i = 0; i < app.sources.size(); ++i) {
    const SourceSpec& source = app.sources[i];
    if (source.clock < 0 || at(source.clock) >= app.clocks.size())
      return invalid("names an unknown clock", nth("sources", i) + "/clock");
    if (source.offset_us < 0 ||
        static_cast<__int128>(source.offset_us) * source.period.den >= source.period.num)
      return invalid("source " + quoted(source.name) + ": " + std::to_string(source.offset_us) +
                         " is not an offset from 0 to below its period (" + source.period.text() +
                         ")",
                     nth("sources", i) + "/offset_us");
    XAUTO_TRY(in_range(source.jitter_us, 0, kMaxPeriodUs, "a jitter in us",
                       nth("sources", i) + "/jitter_us"));
  }
  return {};
}

/// A module marks what it heard of, for those who hear of it.
Status validate_marking(const AppSpec& app, int source, const std::string& where) {
  const std::string& module = app.sources[at(source)].urgent->marked_by;
  std::vector<char> hears(app.xnodes.size(), 0);
  const std::vector<std::vector<int>> after = app.successors();
  bool knows = false, heard = false;
  for (const int i : app.topological_order()) {
    const XNodeSpec& xnode = app.xnodes[at(i)];
    if (std::ranges::find(xnode.sources, source) != xnode.sources.end()) hears[at(i)] = 1;
    knows = knows || (hears[at(i)] != 0 && xnode.module == module);
    for (const int next : after[at(i)]) {
      hears[at(next)] |= hears[at(i)];
      heard = heard || (xnode.module == module && app.xnodes[at(next)].module != module);
    }
  }
  const std::string who = "module " + quoted(module);
  if (!knows)
    return invalid(
        who + " does not hear of source " + quoted(app.sources[at(source)].name) + " by edges",
        where, "name one that does, or leave it out: then the source's driver marks");
  if (!heard)
    return invalid(who + " has nobody who hears of it by edges: nothing would be urgent", where,
                   "name a module before those that shall be sooner");
  return {};
}

/// An urgent release may reach the one before, and not overtake it. Of one component's sources one may
/// say so: a release that several make urgent would have several amounts and distances.
Status validate_urgent(const AppSpec& app, const Components& components) {
  for (std::size_t i = 0; i < app.sources.size(); ++i) {
    const SourceSpec& source = app.sources[i];
    if (!source.urgent) continue;
    const std::string where = nth("sources", i) + "/urgent";
    XAUTO_TRY(in_range(source.urgent->by_us, 1, kMaxPeriodUs, "a time in us", where + "/by_us"));
    XAUTO_TRY(
        in_range(source.urgent->every_us, 1, kMaxPeriodUs, "a time in us", where + "/every_us"));
    const auto above = [&](std::int64_t us) {  // its sign: us - period
      return static_cast<__int128>(us) * source.period.den - source.period.num;
    };
    if (above(source.urgent->by_us) > 0)
      return invalid("source " + quoted(source.name) + ": " + std::to_string(source.urgent->by_us) +
                         " us are above its period (" + source.period.text() +
                         "): an urgent release would overtake the one before",
                     where + "/by_us", "state at most the period");
    if (above(source.urgent->every_us) < 0)
      return invalid(
          "source " + quoted(source.name) + ": " + std::to_string(source.urgent->every_us) +
              " us are below its period (" + source.period.text() + ")",
          where + "/every_us", "where each release may be urgent, state the period, rounded up");
    if (!source.urgent->marked_by.empty())
      XAUTO_TRY(validate_marking(app, static_cast<int>(i), where + "/marked_by"));
  }
  for (const Component& component : components.components) {
    int first = -1;
    for (const int s : component.sources) {
      if (!app.sources[at(s)].urgent) continue;
      if (first >= 0)
        return invalid(
            "sources " + quoted(app.sources[at(first)].name) + " and " +
                quoted(app.sources[at(s)].name) + " are joined by edges, and both may be urgent",
            nth("sources", at(s)) + "/urgent", "state it of one of them, or sample the other one");
      first = s;
    }
  }
  return {};
}

Status validate_transfers(const AppSpec& app) {
  if (app.transfers.size() > kMaxTransfers)
    return invalid("more than " + std::to_string(kMaxTransfers) + " times of transfers", "/edges");
  std::set<std::tuple<int, std::string_view, std::string_view>> seen;
  for (const TransferSpec& t : app.transfers) {
    if (t.edge < 0 || at(t.edge) >= app.edges.size())
      return invalid("a transfer along an unknown edge", "/edges");
    const std::string where = nth("edges", at(t.edge)) + "/transfer_us/" + t.from_type;
    const XNodeSpec &from = app.xnodes[at(app.edges[at(t.edge)].first)],
                    &to = app.xnodes[at(app.edges[at(t.edge)].second)];
    if (!from.wcet_on(t.from_type))
      return invalid(
          "XNode " + quoted(from.name) + " has no implementation for " + quoted(t.from_type),
          where);
    if (!to.wcet_on(t.to_type))
      return invalid("XNode " + quoted(to.name) + " has no implementation for " + quoted(t.to_type),
                     where + "/" + t.to_type);
    XAUTO_TRY(in_range(t.transfer_us, 0, kMaxTimeUs, "a time in us", where + "/" + t.to_type));
    if (!seen.insert({t.edge, t.from_type, t.to_type}).second)
      return invalid("a transfer is there twice", where + "/" + t.to_type);
  }
  return {};
}

/// Inside a component a sample may only lead back: v precedes u, and reads what an earlier
/// activation of u has left. That is no path of a chain (the component would be there twice), so no
/// figure depends on it. Any other would carry data past the chains' worst cases: v may read u of
/// this activation or of the one before, and edges say which.
Status validate_inner_samples(const AppSpec& app, const Components& components) {
  std::vector<std::size_t> inner;
  for (std::size_t k = 0; k < app.samples.size(); ++k)
    if (components.of[at(app.samples[k].first)] == components.of[at(app.samples[k].second)])
      inner.push_back(k);
  std::sort(inner.begin(), inner.end(), [&](std::size_t a, std::size_t b) {
    return app.samples[a].second < app.samples[b].second;
  });
  if (inner.empty()) return {};
  const std::vector<int> order = app.topological_order();
  const auto succ = app.successors();
  for (std::size_t begin = 0; begin < inner.size();) {
    // What up to 64 of the readers precede, in one go: a bit each.
    std::unordered_map<int, int> bit;
    std::size_t end = begin;
    for (; end < inner.size(); ++end) {
      const int reader = app.samples[inner[end]].second;
      if (!bit.contains(reader) && bit.size() == 64) break;
      bit.try_emplace(reader, static_cast<int>(bit.size()));
    }
    std::vector<std::uint64_t> behind(app.xnodes.size(), 0);
    for (const auto& [reader, b] : bit) behind[at(reader)] |= std::uint64_t{1} << b;
    for (const int x : order)
      for (const int s : succ[at(x)]) behind[at(s)] |= behind[at(x)];
    for (; begin < end; ++begin) {
      const auto [u, v] = app.samples[inner[begin]];
      if ((behind[at(u)] >> bit[v] & 1) == 0)
        return invalid("XNodes " + quoted(app.xnodes[at(u)].name) + " and " +
                           quoted(app.xnodes[at(v)].name) +
                           " are in one component, which fires as one",
                       nth("samples", inner[begin]),
                       "make it an edge; inside a component a sample only leads back, to an XNode "
                       "that precedes");
    }
  }
  return {};
}

Status validate_samples(const AppSpec& app, const Components& components) {
  std::set<std::pair<int, int>> seen;
  for (std::size_t k = 0; k < app.samples.size(); ++k) {
    const auto [u, v] = app.samples[k];
    if (!seen.insert({u, v}).second)
      return invalid("sample " + quoted(app.xnodes[at(u)].name) + " -> " +
                         quoted(app.xnodes[at(v)].name) + " is there twice",
                     nth("samples", k));
  }
  return validate_inner_samples(app, components);
}

Status validate_chains(const AppSpec& app, const Components& components) {
  if (app.chains.size() > kMaxAppChains)
    return invalid("more than " + std::to_string(kMaxAppChains) + " chains", "/chains",
                   "without \"chains\", every source to every last XNode is one: state those that "
                   "matter");
  if (app.chains.empty()) return invalid("no chain", "/chains");
  XAUTO_TRY(validate_names(app.chains, "chains", "chain"));
  // By source, so that each is followed once.
  std::vector<std::size_t> order(app.chains.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  for (const std::size_t i : order) {
    const ChainSpec& chain = app.chains[i];
    const std::string where = nth("chains", i);
    if (chain.from < 0 || at(chain.from) >= app.sources.size())
      return invalid("names an unknown source", where + "/from");
    if (chain.to < 0 || at(chain.to) >= app.xnodes.size())
      return invalid("names an unknown XNode", where + "/to");
    if (chain.deadline_us)
      XAUTO_TRY(
          in_range(*chain.deadline_us, 1, kMaxTimeUs, "a deadline in us", where + "/deadline_us"));
    XAUTO_TRY(in_range(chain.weight, 0, kMaxWeight, "a weight", where + "/weight"));
  }
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return app.chains[a].from < app.chains[b].from;
  });
  Ways ways(app, components);
  for (const std::size_t i : order)
    if (const ChainSpec& chain = app.chains[i]; !ways.exists(chain.from, chain.to))
      return invalid("XNode " + quoted(app.xnodes[at(chain.to)].name) +
                         " does not hear of source " + quoted(app.sources[at(chain.from)].name),
                     nth("chains", i),
                     "edges, and samples between components, must lead there without entering a "
                     "component twice");
  return {};
}

}  // namespace

std::vector<ChainSpec> default_chains(const AppSpec& app) {
  const auto components = find_components(app);
  if (!components) return {};  // validate() says why
  const std::vector<char> last = ends_of(app);
  Ways ways(app, *components);
  std::vector<ChainSpec> chains;
  std::set<std::string> names;
  for (std::size_t s = 0; s < app.sources.size(); ++s)
    for (std::size_t i = 0; i < app.xnodes.size() && chains.size() <= kMaxAppChains; ++i) {
      if (!last[i] || !ways.exists(static_cast<int>(s), static_cast<int>(i))) continue;
      std::string name = app.sources[s].name + " -> " + app.xnodes[i].name;
      if (name.size() > kMaxNameBytes || names.contains(name))
        name = "chain " + std::to_string(chains.size());
      names.insert(name);
      chains.push_back({std::move(name), static_cast<int>(s), static_cast<int>(i)});
    }
  return chains;
}

void complete_modules(AppSpec& app) {
  std::unordered_map<std::string_view, ModuleSpec> given;
  for (const ModuleSpec& module : app.modules) given.try_emplace(module.name, module);
  std::vector<ModuleSpec> modules;
  std::unordered_set<std::string_view> seen;
  for (const XNodeSpec& x : app.xnodes) {
    if (!seen.insert(x.module).second) continue;
    const auto found = given.find(x.module);
    modules.push_back(found == given.end() ? ModuleSpec{x.module} : found->second);
  }
  // Those that nobody names stay, behind the others, for validate() to refuse.
  for (const ModuleSpec& module : app.modules)
    if (!seen.contains(module.name)) modules.push_back(module);
  app.modules = std::move(modules);
}

void complete_chains(AppSpec& app) {
  if (app.chains.empty()) app.chains = default_chains(app);
}

void give_deadlines(AppSpec& app) {
  for (ChainSpec& chain : app.chains)
    if (!chain.deadline_us) chain.deadline_us = app.deadline_us;
}

namespace {

/// What has no meaning where the next release waits for the end of this one.
Status validate_one_at_a_time(const AppSpec& app) {
  const char* hint = "give every source a rate: rate_hz or period_us";
  for (std::size_t i = 0; i < app.sources.size(); ++i) {
    const SourceSpec& source = app.sources[i];
    if (source.period != kNoRate)
      return invalid(
          "source " + quoted(source.name) + " has a rate in an app that releases one at a time",
          nth("sources", i));
    if (source.offset_us != 0 || source.jitter_us != 0 || source.clock != 0 || source.urgent)
      return invalid(
          "source " + quoted(source.name) +
              " has no rate: it has neither offset nor jitter, clock nor urgent releases",
          nth("sources", i), hint);
  }
  for (std::size_t m = 0; m < app.modules.size(); ++m)
    if (app.modules[m].max_in_flight != 1)
      return invalid(
          "several activations in flight, and no source has a rate: the next release "
          "waits for the end of this one",
          nth("modules", m) + "/max_in_flight", hint);
  if (!app.samples.empty())
    return invalid(
        "a sample reads what another release left, and no source has a rate: nobody "
        "knows how old that is",
        nth("samples", 0), hint);
  return {};
}

}  // namespace

Status validate_periodic(const AppSpec& app) {
  XAUTO_TRY(validate_clocks(app));
  if (app.one_at_a_time) XAUTO_TRY(validate_one_at_a_time(app));
  const auto pred = app.predecessors();
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    if (pred[i].empty() && app.xnodes[i].sources.empty())
      return invalid("XNode " + quoted(app.xnodes[i].name) +
                         " has neither a predecessor nor a source: nothing releases it",
                     nth("xnodes", i), "name its \"source\"; a sample releases nobody");
  XAUTO_TRY(validate_transfers(app));
  if (app.samples.size() > kMaxSamples)
    return invalid(std::to_string(app.samples.size()) + " samples; at most " +
                       std::to_string(kMaxSamples) + " are possible",
                   "/samples");
  for (std::size_t k = 0; k < app.samples.size(); ++k)
    for (const int end : {app.samples[k].first, app.samples[k].second})
      if (end < 0 || at(end) >= app.xnodes.size())
        return invalid("names an unknown XNode", nth("samples", k));
  XAUTO_ASSIGN(const Components components, find_components(app));
  XAUTO_TRY(validate_urgent(app, components));
  XAUTO_TRY(validate_samples(app, components));
  return validate_chains(app, components);
}

}  // namespace xauto

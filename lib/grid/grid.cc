// SPDX-License-Identifier: Apache-2.0
#include "grid/grid.h"

#include <algorithm>

#include "model/components.h"

namespace xauto::runtime {
namespace {

constexpr std::uint32_t kLeastDepth = 4, kMostDepth = 1024;

Error refused(std::string what, std::string where, std::string hint) {
  return {ErrorCode::kInvalid, std::move(what), std::move(where), std::move(hint)};
}

/// [module][source] whether it hears of it, directly or through others.
using Heard = std::vector<std::vector<char>>;

Heard heard_in(const Graph& graph) {
  Heard heard(graph.modules.size(), std::vector<char>(graph.sources.size(), 0));
  for (const int m : graph.module_order) {
    std::vector<char>& here = heard[static_cast<std::size_t>(m)];
    for (const int t : graph.modules[static_cast<std::size_t>(m)].inputs) {
      const Graph::Topic& topic = graph.topics[static_cast<std::size_t>(t)];
      if (topic.source >= 0) {
        here[static_cast<std::size_t>(topic.source)] = 1;
        continue;
      }
      const std::vector<char>& of = heard[static_cast<std::size_t>(topic.module)];
      for (std::size_t s = 0; s < of.size(); ++s) here[s] |= of[s];
    }
  }
  return heard;
}

/// How many activations of `module` may wait.
std::uint32_t depth_of(const Graph& graph, const Session& session, const Graph::Module& module,
                       const Component& component) {
  // A job that comes early waits no longer than until its own key.
  std::int64_t last_us = 0;
  for (std::size_t t = 0; session.keys && t < session.num_tables(); ++t)
    for (const int n : module.nodes) {
      const int x = session.app.find(graph.nodes[static_cast<std::size_t>(n)].name);
      for (const std::int64_t key :
           session.keys_of(t).placements[static_cast<std::size_t>(x)].key_us)
        last_us = std::max(last_us, key);
    }
  // Some may be late while one table takes the place of another.
  if (session.tables)
    for (const Handover& handover : session.tables->handovers)
      for (const auto& us : handover.worst_case_us)
        if (us && last_us > 0) last_us = std::max(last_us, *us);
  const std::int64_t releases = last_us / std::max<std::int64_t>(1, component.period.floor_us());
  return static_cast<std::uint32_t>(
      std::clamp<std::int64_t>(releases + 2, kLeastDepth, kMostDepth));
}

/// A module that hears a source beside other modules waits for both; app.json knows of the modules
/// alone. That is the same as long as the source cannot be the last.
Status check_joins(const Graph& graph, const Session& session, const Grid& grid,
                   const Heard& heard) {
  for (std::size_t m = 0; m < graph.modules.size(); ++m) {
    const Graph::Module& module = graph.modules[m];
    const auto from_module = [&](int t) {
      return graph.topics[static_cast<std::size_t>(t)].module >= 0;
    };
    if (std::none_of(module.inputs.begin(), module.inputs.end(), from_module)) continue;
    for (std::size_t i = 0; i < module.inputs.size(); ++i) {
      const int s = graph.topics[static_cast<std::size_t>(module.inputs[i])].source;
      if (s < 0) continue;
      bool behind = false;  // one of its predecessors waits for the same message
      for (const int t : module.inputs)
        if (const int u = graph.topics[static_cast<std::size_t>(t)].module; u >= 0)
          behind |= heard[static_cast<std::size_t>(u)][static_cast<std::size_t>(s)] != 0;
      const Grid::Source& source = grid.sources[static_cast<std::size_t>(s)];
      if (behind || grid.shift_ns[m][i] + source.jitter_ns == 0) continue;
      return tl::unexpected<Error>(refused(
          "XModule '" + module.name + "' fires by topic '" +
              graph.sources[static_cast<std::size_t>(s)].name +
              "' and by other modules that do not wait for it; the plan knows only of those",
          "app '" + session.app.name + "'",
          "sample the topic (add_sampled_topic), or give its source no jitter and no offset"));
    }
  }
  return {};
}

}  // namespace

std::int64_t Grid::Source::due_ns(std::uint64_t k) const {
  const __int128 ns = static_cast<__int128>(k) * period.num * 1000;
  if (period.den == 1) return offset_ns + static_cast<std::int64_t>(ns);
  return offset_ns + static_cast<std::int64_t>(ns / period.den);
}

/// The plan may allow fewer activations than the program has states for, not more.
Status Grid::take_in_flight(const Graph& graph, const AppSpec& app) {
  for (std::size_t m = 0; m < graph.modules.size(); ++m) {
    std::int64_t planned = 1;
    for (const ModuleSpec& module : app.modules)
      if (module.name == graph.modules[m].name) planned = module.max_in_flight;
    if (planned > in_flight[m])
      return tl::unexpected<Error>(refused(
          "XModule '" + graph.modules[m].name + "' has max_in_flight " + std::to_string(planned) +
              "; the program allows " + std::to_string(in_flight[m]),
          "app '" + app.name + "'",
          "call XModule::in_flight(" + std::to_string(planned) +
              ") if nothing is carried from one activation to the next, or set "
              "max_in_flight to " +
              std::to_string(in_flight[m]) + " and solve again"));
    in_flight[m] = static_cast<int>(planned);
  }
  return {};
}

Grid Grid::of_program(const Graph& graph, const Session& session) {
  Grid grid;
  grid.periodic = session.mode == Mode::kRun && !session.app.sources.empty();
  for (const Graph::Module& module : graph.modules) {
    grid.shift_ns.emplace_back(module.inputs.size(), 0);
    grid.in_flight.push_back(module.spec->in_flight);
  }
  grid.depth.assign(graph.modules.size(), 1);
  grid.urgent_by_us.assign(graph.modules.size(), 0);
  grid.urgent_source.assign(graph.modules.size(), -1);
  grid.marks_apart.assign(graph.modules.size(), 0);
  for (const SourceSpec& source : graph.sources)
    grid.sources.push_back(
        {session.releases.period_us > 0 ? Period{session.releases.period_us} : source.period, 0, 0,
         0, static_cast<std::uint32_t>(grid.sources.size())});
  return grid;
}

namespace {

/// Releases are on the grid: so are the distances of those that are urgent.
std::uint64_t urgent_apart(const SourceSpec& spec) {
  const std::int64_t apart = spec.urgent->every_us * spec.period.den + spec.period.num - 1;
  return static_cast<std::uint64_t>(apart / spec.period.num);
}

/// [module] whether it hears, by its inputs, of what the module called `marks` publishes; all do where it has no name.
std::vector<char> hearers_of(const Graph& graph, const std::string& marks) {
  std::vector<char> hears(graph.modules.size(), marks.empty() ? 1 : 0);
  if (marks.empty()) return hears;
  for (const int m : graph.module_order)
    for (const int topic : graph.modules[static_cast<std::size_t>(m)].inputs) {
      const int by = graph.topics[static_cast<std::size_t>(topic)].module;
      if (by < 0) continue;
      const auto from = static_cast<std::size_t>(by);
      if (hears[from] != 0 || graph.modules[from].name == marks)
        hears[static_cast<std::size_t>(m)] = 1;
    }
  return hears;
}

}  // namespace

Status Grid::take_sources(const Graph& graph, const AppSpec& app) {
  Period longest;
  for (const Source& source : sources) longest = std::max(longest, source.period);
  clock_ppm.clear();
  for (const ClockSpec& clock : app.clocks) clock_ppm.push_back(clock.ppm);
  for (std::size_t s = 0; s < graph.sources.size(); ++s) {
    const auto named = std::ranges::find(app.sources, graph.sources[s].name, &SourceSpec::name);
    if (named == app.sources.end())
      return tl::unexpected<Error>(refused(
          "app.json has no source '" + graph.sources[s].name + "'", "app '" + app.name + "'",
          "app.json describes another version of this program: profile it again"));
    const SourceSpec& spec = *named;
    sources[s] = {app.one_at_a_time ? longest : spec.period, spec.offset_us * 1000,
                  spec.jitter_us * 1000, static_cast<std::size_t>(spec.clock),
                  static_cast<std::uint32_t>(named - app.sources.begin())};
    if (spec.urgent && spec.urgent->marked_by.empty()) sources[s].urgent_apart = urgent_apart(spec);
  }
  return {};
}

Status Grid::take_modules(const Graph& graph, const Session& session) {
  const AppSpec& app = session.app;
  XAUTO_ASSIGN(const Components components, find_components(app));
  const Heard heard = heard_in(graph);
  for (std::size_t m = 0; m < graph.modules.size(); ++m) {
    const Graph::Module& module = graph.modules[m];
    const int xnode = app.find(graph.nodes[static_cast<std::size_t>(module.nodes.front())].name);
    const Component& component =
        components
            .components[static_cast<std::size_t>(components.of[static_cast<std::size_t>(xnode)])];
    for (std::size_t i = 0; i < module.inputs.size(); ++i) {
      const int source = graph.topics[static_cast<std::size_t>(module.inputs[i])].source;
      if (source < 0) continue;
      Source& of = sources[static_cast<std::size_t>(source)];
      of.shift_ns = of.offset_ns - component.offset_us * 1000;
      shift_ns[m][i] = of.shift_ns;
    }
    depth[m] = depth_of(graph, session, module, component);
  }
  for (std::size_t s = 0; s < graph.sources.size(); ++s) {
    const SourceSpec& spec = app.sources[sources[s].number];
    if (!spec.urgent) continue;
    const std::vector<char> hurries = hearers_of(graph, spec.urgent->marked_by);
    for (std::size_t m = 0; m < graph.modules.size(); ++m) {
      if (heard[m][s] == 0) continue;
      if (graph.modules[m].name == spec.urgent->marked_by) marks_apart[m] = urgent_apart(spec);
      if (hurries[m] == 0) continue;
      urgent_source[m] = static_cast<int>(s);
      urgent_by_us[m] = spec.urgent->by_us;
    }
  }
  return check_joins(graph, session, *this, heard);
}

Result<Grid> Grid::make(const Graph& graph, const Session& session) {
  Grid grid = of_program(graph, session);
  if (!grid.periodic) return grid;
  const AppSpec& app = session.app;
  grid.one_at_a_time = app.one_at_a_time;
  if (session.releases.period_us > 0 && !app.one_at_a_time)
    return tl::unexpected<Error>(
        refused("would change what the policy was made for", "--period",
                "change the sources in app.json and solve again; `xauto solve --assume` tries it"));
  XAUTO_TRY(grid.take_in_flight(graph, app));
  XAUTO_TRY(grid.take_sources(graph, app));
  XAUTO_TRY(grid.take_modules(graph, session));
  return grid;
}

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
#include "graph/graph.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "model/app.h"
#include "model/onward.h"

namespace xauto::runtime {
namespace {

constexpr const char* kStale =
    "app.json describes another version of this program, or other names: profile it again with "
    "`xauto profile`, with the same deployment";

class Builder {
 public:
  explicit Builder(const detail::AppSpecErased& app) : app_(app) { graph_.name = app.name; }

  Result<Graph> build() {
    check_name("app", app_.name);
    add_sources();
    for (const auto& module : app_.modules) add_module(*module);
    connect();
    find_components();
    check_observers();
    add_clocks();
    add_deadlines();
    count_parameters();
    order_modules();
    if (!problems_.empty()) {
      std::string text = problems_.front();
      for (std::size_t i = 1; i < problems_.size(); ++i) text += "\n  " + problems_[i];
      return fail(ErrorCode::kInvalid, text, "app '" + app_.name + "'");
    }
    return std::move(graph_);
  }

 private:
  void problem(std::string text) { problems_.push_back(std::move(text)); }

  /// app.json has the names: those that it would refuse are none here.
  void check_name(const std::string& what, const std::string& name) {
    const std::string fault = fault_of_name(name);
    if (fault.empty()) return;
    std::string shown = name.substr(0, 60);
    for (char& c : shown)
      if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) > 0x7e) c = '?';
    problem(what + " '" + shown + (name.size() > 60 ? "..." : "") + "': the name " + fault);
  }

  /// The topic's index; reports a second type for one name.
  int topic(const detail::TopicSpec& spec, const std::string& who) {
    const auto [at, added] =
        topic_by_name_.try_emplace(spec.name, static_cast<int>(graph_.topics.size()));
    if (added) {
      check_name("topic", spec.name);
      graph_.topics.push_back({spec, -1, -1, {}});
      first_user_.push_back(who);
      return at->second;
    }
    const Graph::Topic& known = graph_.topics[static_cast<std::size_t>(at->second)];
    if (known.spec.type != spec.type)
      problem("topic '" + spec.name + "' has two types: " + known.spec.type_name + " (" +
              first_user_[static_cast<std::size_t>(at->second)] + ") and " + spec.type_name + " (" +
              who + ")");
    return at->second;
  }

  void add_sources() {
    for (std::size_t i = 0; i < app_.sources.size(); ++i) {
      const detail::SourceSpec& source = app_.sources[i];
      const int t = topic(source.topic, "a source");
      Graph::Topic& info = graph_.topics[static_cast<std::size_t>(t)];
      if (info.source >= 0) problem("topic '" + info.spec.name + "' has two sources");
      info.source = static_cast<int>(i);
      if (!source.period.valid())
        problem("the source of topic '" + info.spec.name + "' has a period of " +
                std::to_string(source.period.num) + " us; possible are 1 to " +
                std::to_string(kMaxPeriodUs) + " us");
      graph_.sources.push_back({info.spec.name, source.period});
      graph_.sources.back().pushed = source.inlet != nullptr;
      graph_.topic_of_source.push_back(t);
      if (source.period != app_.sources.front().period) graph_.single_rate = false;
      if (source.inlet != nullptr && app_.sources.size() > 1) graph_.single_rate = false;
    }
    if (app_.sources.empty()) problem("no source: nothing would ever fire");
  }

  void add_parameters(Graph::Module& module) {
    const std::string who = "XModule '" + module.name + "'";
    module.parameters = detail::parameters_of(*module.spec);
    std::set<std::string> names;
    for (const detail::ParameterHandle& parameter : module.parameters) {
      if (const std::string misuse = parameter->misuse(); !misuse.empty())
        problem(who + ": " + misuse);
      else if (!names.insert(parameter->name).second)
        problem(who + " has two parameters called '" + parameter->name + "'");
    }
    if (module.parameters.size() > kMaxModuleParameters)
      problem(who + " has " + std::to_string(module.parameters.size()) + " parameters; at most " +
              std::to_string(kMaxModuleParameters) + " are possible");
  }

  void count_parameters() {
    std::size_t count = 0;
    for (const Graph::Module& module : graph_.modules) count += module.parameters.size();
    if (count > kMaxParameters)
      problem("the app has " + std::to_string(count) + " parameters; at most " +
              std::to_string(kMaxParameters) + " are possible");
  }

  void add_module(const detail::XModuleSpec& spec) {
    const int index = static_cast<int>(graph_.modules.size());
    for (const std::string& text : spec.misuse) problem(text);
    check_name("XModule", spec.name);
    if (spec.name.empty()) problem("an XModule has no name");
    if (!module_names_.insert(spec.name).second)
      problem("two XModules are called '" + spec.name + "'");
    if (spec.nodes.empty()) problem("XModule '" + spec.name + "' has no XNode");
    if (spec.inputs.empty())
      problem("XModule '" + spec.name + "' has no input topic: it would never fire");

    Graph::Module module;
    module.name = spec.name;
    module.spec = &spec;
    for (const auto& node : spec.nodes) {
      for (const std::string& text : node->misuse) problem(text);
      check_name("XNode", node->name);
      for (const detail::ImplSpec& impl : node->impls) check_name("variant", impl.variant);
      if (node->name.empty()) problem("an XNode of XModule '" + spec.name + "' has no name");
      const auto [at, added] = node_module_.try_emplace(node->name, spec.name);
      if (!added && at->second != spec.name)
        problem("XNode '" + node->name + "' is in two XModules, '" + at->second + "' and '" +
                spec.name + "'");
      if (std::none_of(node->impls.begin(), node->impls.end(),
                       [](const detail::ImplSpec& impl) { return impl.variant.empty(); }))
        problem("XNode '" + node->name + "' has no implementation" +
                (node->impls.empty() ? "" : " of its own, only variants"));
      for (const detail::ImplSpec& impl : node->impls)
        if (impl.xpu.type().empty())
          problem("XNode '" + node->name + "' has an implementation for an XPU type without name");
      module.nodes.push_back(static_cast<int>(graph_.nodes.size()));
      graph_.nodes.push_back({node->name, index, node.get()});
    }
    add_parameters(module);
    for (const detail::TopicSpec& input : spec.inputs) {
      if (detail::is_name_alone(input)) {
        problem("XModule '" + spec.name + "' reads topic '" + input.name +
                "' by its name alone, and no Topic of that name says what it carries");
        continue;
      }
      const int t = topic(input, "XModule '" + spec.name + "' reads it");
      if (std::find(module.inputs.begin(), module.inputs.end(), t) != module.inputs.end())
        problem("XModule '" + spec.name + "' reads topic '" + input.name + "' twice");
      graph_.topics[static_cast<std::size_t>(t)].subscribers.push_back(
          {index, static_cast<int>(module.inputs.size())});
      module.inputs.push_back(t);
    }
    for (const detail::SampleSpec& sample : spec.samples) {
      const int t = topic(sample.topic, "XModule '" + spec.name + "' samples it");
      for (const std::vector<int>* read : {&module.inputs, &module.samples})
        if (std::find(read->begin(), read->end(), t) != read->end())
          problem("XModule '" + spec.name + "' reads topic '" + sample.topic.name + "' twice");
      graph_.topics[static_cast<std::size_t>(t)].subscribers.push_back(
          {index, static_cast<int>(module.inputs.size() + module.samples.size()), true});
      module.samples.push_back(t);
    }
    for (const detail::OutputSpec& output : spec.outputs) {
      const int t = topic(output.topic, "XModule '" + spec.name + "' publishes it");
      Graph::Topic& info = graph_.topics[static_cast<std::size_t>(t)];
      if (info.source >= 0)
        problem("topic '" + info.spec.name + "' has two publishers: a source and XModule '" +
                spec.name + "'");
      else if (info.module >= 0)
        problem("topic '" + info.spec.name + "' has two publishers: XModule '" +
                graph_.modules[static_cast<std::size_t>(info.module)].name + "' and XModule '" +
                spec.name + "'");
      info.module = index;
      module.outputs.push_back(t);
    }
    graph_.modules.push_back(std::move(module));
  }

  void connect() {
    for (const Graph::Module& module : graph_.modules)
      for (std::size_t i = 1; i < module.nodes.size(); ++i)
        graph_.edges.emplace_back(module.nodes[i - 1], module.nodes[i]);
    for (const Graph::Topic& topic : graph_.topics) {
      if (topic.source < 0 && topic.module < 0 && !topic.subscribers.empty())
        for (const Graph::Subscriber& subscriber : topic.subscribers)
          problem("topic '" + topic.spec.name + "' has no publisher, but XModule '" +
                  graph_.modules[static_cast<std::size_t>(subscriber.module)].name + "' reads it");
      if (topic.module < 0) continue;
      const Graph::Module& from = graph_.modules[static_cast<std::size_t>(topic.module)];
      for (const Graph::Subscriber& subscriber : topic.subscribers) {
        const Graph::Module& to = graph_.modules[static_cast<std::size_t>(subscriber.module)];
        if (from.nodes.empty() || to.nodes.empty()) continue;
        if (!subscriber.sampled && from.spec->optional && !to.spec->optional)
          problem("XModule '" + to.name + "' waits for XModule '" + from.name +
                  "', which is optional, and is not optional itself");
        const std::pair<int, int> edge(from.nodes.back(), to.nodes.front());
        auto& into = subscriber.sampled ? graph_.samples : graph_.edges;
        if (std::find(into.begin(), into.end(), edge) == into.end()) into.push_back(edge);
      }
    }
    std::vector<char> has_predecessor(graph_.nodes.size(), 0);
    for (const auto& [u, v] : graph_.edges) has_predecessor[static_cast<std::size_t>(v)] = 1;
    for (const Graph::Module& module : graph_.modules) {
      if (module.nodes.empty()) continue;
      const auto first = static_cast<std::size_t>(module.nodes.front());
      if (has_predecessor[first]) continue;
      for (const int t : module.inputs)
        if (const int s = graph_.topics[static_cast<std::size_t>(t)].source; s >= 0)
          graph_.nodes[first].sources.push_back(s);
    }
    for (Graph::Module& module : graph_.modules)
      module.sink = std::all_of(module.outputs.begin(), module.outputs.end(), [&](int t) {
        const auto& readers = graph_.topics[static_cast<std::size_t>(t)].subscribers;
        return std::all_of(readers.begin(), readers.end(),
                           [](const Graph::Subscriber& s) { return s.sampled; });
      });
  }

  /// Modules that fire each other have numbers in common, where their sources do.
  void find_components() {
    for (std::size_t first = 0; first < graph_.modules.size(); ++first) {
      if (graph_.modules[first].component >= 0) continue;
      std::vector<std::size_t> members, open = {first};
      const auto enter = [&](int module) {
        int& component = graph_.modules[static_cast<std::size_t>(module)].component;
        if (component >= 0) return;
        component = graph_.components;
        open.push_back(static_cast<std::size_t>(module));
      };
      graph_.modules[first].component = graph_.components;
      while (!open.empty()) {
        const std::size_t m = open.back();
        open.pop_back();
        members.push_back(m);
        for (const int t : graph_.modules[m].inputs)
          if (const int from = graph_.topics[static_cast<std::size_t>(t)].module; from >= 0)
            enter(from);
        for (const int t : graph_.modules[m].outputs)
          for (const Graph::Subscriber& s : graph_.topics[static_cast<std::size_t>(t)].subscribers)
            if (!s.sampled) enter(s.module);
      }
      ++graph_.components;
      std::set<int> sources;
      for (const std::size_t m : members)
        for (const int t : graph_.modules[m].inputs)
          if (const int s = graph_.topics[static_cast<std::size_t>(t)].source; s >= 0)
            sources.insert(s);
      bool numbered = true;
      for (const int s : sources) {
        const auto at = static_cast<std::size_t>(s);
        if (graph_.sources[at].period !=
            graph_.sources[static_cast<std::size_t>(*sources.begin())].period)
          numbered = false;
        if (graph_.sources[at].pushed && sources.size() > 1) numbered = false;
      }
      for (const std::size_t m : members) graph_.modules[m].numbered = numbered;
    }
    find_sample_origins();
    graph_.tells_origins = !graph_.single_rate || !graph_.samples.empty();
  }

  /// Which sources' origins each sample carries onward (ranks_of).
  void find_sample_origins() {
    const auto component = [&](int m) {
      return graph_.modules[static_cast<std::size_t>(m)].component;
    };
    std::vector<std::pair<int, int>> samples;  // of components
    for (Graph::Module& module : graph_.modules) {
      module.sample_origins.assign(module.samples.size(), 0);
      for (const int t : module.samples)
        if (const int from = graph_.topics[static_cast<std::size_t>(t)].module; from >= 0)
          samples.emplace_back(component(from), module.component);
    }
    for (std::size_t s = 0; s < graph_.sources.size() && s < detail::kMaxOrigins; ++s) {
      const int topic = graph_.topic_of_source[s];
      std::vector<char> hears(static_cast<std::size_t>(graph_.components), 0);
      for (const Graph::Module& module : graph_.modules)
        for (const std::vector<int>* heard : {&module.inputs, &module.samples})
          if (std::find(heard->begin(), heard->end(), topic) != heard->end())
            hears[static_cast<std::size_t>(module.component)] = 1;
      const std::vector<int> rank = ranks_of(hears, samples);
      const auto rank_of = [&](int c) { return rank[static_cast<std::size_t>(c)]; };
      for (Graph::Module& module : graph_.modules)
        for (std::size_t i = 0; i < module.samples.size(); ++i) {
          const int from = graph_.topics[static_cast<std::size_t>(module.samples[i])].module;
          const bool own = module.samples[i] == topic;
          const bool onward = from >= 0 && rank_of(component(from)) != kUnreached &&
                              rank_of(component(from)) < rank_of(module.component);
          if (own || onward) module.sample_origins[i] |= 1u << s;
        }
    }
  }

  void check_observers() {
    for (const detail::ObserverSpec& observer : app_.observers) {
      const auto known = topic_by_name_.find(observer.topic.name);
      if (known == topic_by_name_.end())
        problem("on_message watches topic '" + observer.topic.name + "', which nobody publishes");
      else
        topic(observer.topic, "on_message");
    }
  }

  /// The source of that topic, or -1 after a problem: `what` says what asks for it.
  int source_of(const detail::TopicSpec& spec, const std::string& what) {
    const auto known = topic_by_name_.find(spec.name);
    const int source = known == topic_by_name_.end()
                           ? -1
                           : graph_.topics[static_cast<std::size_t>(known->second)].source;
    if (source < 0)
      problem(what + " topic '" + spec.name + "', which no source releases");
    else
      topic(spec, what);
    return source;
  }

  void add_clocks() {
    std::vector<ClockSpec>& clocks = graph_.asks.clocks;
    std::set<int> said;
    for (const detail::ClockOfSpec& asked : app_.clocks) {
      const int source = source_of(asked.source, "App::clock names");
      if (source < 0) continue;
      const std::string who = "App::clock of '" + asked.source.name + "'";
      if (!said.insert(source).second) problem(who + " is said twice");
      check_name("clock", asked.clock.name);
      if (asked.clock.name.empty()) problem(who + ": a clock needs a name");
      if (asked.clock.ppm < 0 || asked.clock.ppm > kMaxPpm)
        problem(who + ": " + std::to_string(asked.clock.ppm) + " ppm; possible are 0 to " +
                std::to_string(kMaxPpm));
      auto at = std::find_if(clocks.begin(), clocks.end(),
                             [&](const ClockSpec& c) { return c.name == asked.clock.name; });
      if (at == clocks.end()) at = clocks.insert(clocks.end(), asked.clock);
      if (*at != asked.clock && asked.clock.name != kMainClock)
        problem("clock '" + at->name + "' is off by at most " + std::to_string(at->ppm) +
                " and by at most " + std::to_string(asked.clock.ppm) + " ppm: say one of them");
      at->ppm = asked.clock.ppm;
      graph_.sources[static_cast<std::size_t>(source)].clock =
          static_cast<int>(at - clocks.begin());
    }
  }

  void add_deadlines() {
    const auto in_range = [&](std::int64_t us, const std::string& who) {
      if (us < 1 || us > kMaxTimeUs)
        problem(who + ": " + std::to_string(us) + " us; possible are 1 to " +
                std::to_string(kMaxTimeUs));
    };
    if (app_.deadlines_us.size() > 1) problem("App::deadline of all chains is said twice");
    for (const std::int64_t us : app_.deadlines_us) {
      in_range(us, "App::deadline");
      graph_.asks.deadline_us = us;
    }
    for (const detail::DeadlineSpec& asked : app_.deadlines) {
      const int source = source_of(asked.from, "App::deadline begins at");
      const std::string to = asked.to ? asked.to->name : asked.module->name;
      const std::string who = "App::deadline from '" + asked.from.name + "' to '" + to + "'";
      in_range(asked.limit_us, who);
      const auto ends =
          std::find_if(graph_.modules.begin(), graph_.modules.end(), [&](const Graph::Module& m) {
            if (!asked.to) return m.name == to;
            return std::any_of(m.outputs.begin(), m.outputs.end(), [&](int t) {
              return graph_.topics[static_cast<std::size_t>(t)].spec.name == to;
            });
          });
      if (ends == graph_.modules.end() || ends->nodes.empty()) {
        problem(who +
                (asked.to ? ": no XModule publishes it" : ": that XModule is not in the app"));
        continue;
      }
      if (asked.to) topic(*asked.to, who);
      if (source < 0) continue;
      const int xnode = ends->nodes.back();
      for (const ChainSpec& other : graph_.asks.chains)
        if (other.from == source && other.to == xnode) problem(who + " is said twice");
      graph_.asks.chains.push_back({"", source, xnode, asked.limit_us});
    }
  }

  /// Depth-first; a module met again while it is still open closes a cycle.
  void order_modules() {
    enum class Mark { kNew, kOpen, kDone };
    std::vector<Mark> marks(graph_.modules.size(), Mark::kNew);
    std::vector<int> path;
    const auto visit = [&](auto&& self, int m) -> bool {
      Mark& mark = marks[static_cast<std::size_t>(m)];
      if (mark == Mark::kDone) return true;
      path.push_back(m);
      if (mark == Mark::kOpen) {
        std::string text = "cycle of XModules: ";
        for (auto at = std::find(path.begin(), path.end(), m); at != path.end(); ++at)
          text += (at == std::find(path.begin(), path.end(), m) ? "" : " -> ") +
                  graph_.modules[static_cast<std::size_t>(*at)].name;
        problem(text);
        return false;
      }
      mark = Mark::kOpen;
      for (const int t : graph_.modules[static_cast<std::size_t>(m)].inputs) {
        const int from = graph_.topics[static_cast<std::size_t>(t)].module;
        if (from >= 0 && !self(self, from)) return false;
      }
      mark = Mark::kDone;
      path.pop_back();
      graph_.module_order.push_back(m);
      return true;
    };
    for (std::size_t m = 0; m < graph_.modules.size(); ++m)
      if (!visit(visit, static_cast<int>(m))) return;
  }

  const detail::AppSpecErased& app_;
  Graph graph_;
  std::vector<std::string> problems_;
  std::map<std::string, int> topic_by_name_;
  std::vector<std::string> first_user_;  ///< [topic]
  std::set<std::string> module_names_;
  std::map<std::string, std::string> node_module_;
};

}  // namespace

Result<Graph> Graph::build(const detail::AppSpecErased& app) {
  return Builder(app).build();
}

Status Graph::same_pairs(const std::vector<std::pair<int, int>>& ours,
                         const std::vector<std::pair<int, int>>& theirs, const std::string& what,
                         const AppSpec& app) const {
  using Names = std::set<std::pair<std::string, std::string>>;
  Names here, there;
  for (const auto& [u, v] : ours)
    here.emplace(nodes[static_cast<std::size_t>(u)].name, nodes[static_cast<std::size_t>(v)].name);
  for (const auto& [u, v] : theirs)
    there.emplace(app.xnodes[static_cast<std::size_t>(u)].name,
                  app.xnodes[static_cast<std::size_t>(v)].name);
  for (const auto& [u, v] : here)
    if (!there.contains({u, v}))
      return fail(ErrorCode::kInvalid,
                  "the " + what + " '" + u + "' -> '" + v + "' is not in app.json", name, kStale);
  for (const auto& [u, v] : there)
    if (!here.contains({u, v}))
      return fail(ErrorCode::kInvalid,
                  "app.json has the " + what + " '" + u + "' -> '" + v + "' that the program lacks",
                  name, kStale);
  return {};
}

void Graph::match_by_origin(int module) {
  const int component = modules[static_cast<std::size_t>(module)].component;
  for (Module& other : modules)
    if (other.component == component) other.numbered = false;
}

Status Graph::matches(const AppSpec& app) const {
  for (const Node& node : nodes) {
    const int i = app.find(node.name);
    if (i < 0)
      return fail(ErrorCode::kInvalid, "XNode '" + node.name + "' is not in app.json", name,
                  kStale);
    const std::string& module = app.xnodes[static_cast<std::size_t>(i)].module;
    if (module != modules[static_cast<std::size_t>(node.module)].name)
      return fail(ErrorCode::kInvalid,
                  "XNode '" + node.name + "' is in XModule '" +
                      modules[static_cast<std::size_t>(node.module)].name + "', app.json says '" +
                      module + "'",
                  name, kStale);
  }
  if (app.xnodes.size() != nodes.size()) {
    for (const XNodeSpec& x : app.xnodes)
      if (std::none_of(nodes.begin(), nodes.end(), [&](const Node& n) { return n.name == x.name; }))
        return fail(ErrorCode::kInvalid,
                    "app.json has an XNode '" + x.name + "' that the program lacks", name, kStale);
  }
  XAUTO_TRY(same_pairs(edges, app.edges, "edge", app));
  return same_pairs(samples, app.samples, "sample", app);
}

const detail::ImplSpec* find_impl(const detail::XNodeSpecErased& node, const std::string& type,
                                  const std::string& variant) {
  for (const detail::ImplSpec& impl : node.impls)
    if (impl.xpu.type() == type && impl.variant == variant) return &impl;
  return nullptr;
}

XpuId xpu_id(const Platform& platform, int xpu) {
  const Xpu& x = platform.xpus[static_cast<std::size_t>(xpu)];
  XpuId id{x.id, XPU(x.type), 0};
  for (int i = 0; i < xpu; ++i)
    if (platform.xpus[static_cast<std::size_t>(i)].type == x.type) ++id.index;
  return id;
}

}  // namespace xauto::runtime

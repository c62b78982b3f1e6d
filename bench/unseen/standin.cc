// SPDX-License-Identifier: Apache-2.0
// A program for an app.json with rates that has none: each XNode keeps an emulated XPU busy for a
// random time, at most its WCET. For unseen.py and ../runtime/sustain.py.
//
//   bench_standin APP SEED SLACK_US
//
// The time of an XNode in a release is drawn by SEED, XNode and release, so that it is the same under
// each policy: one in four takes its whole WCET less SLACK_US, the others 30 % and more of that. SEED
// 0: each takes all of it.
//
// What a program can have: an edge into an XModule comes from the last XNode of another one and ends
// at its first; so do samples. What is otherwise is refused.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "model/json.h"

namespace {

struct Message {
  std::uint64_t number = 0;
};
struct State {
  Message result;
};
using Node = xauto::XNode<State>;
using Module = xauto::XModule<State>;
using MessageTopic = xauto::Topic<Message>;

/// splitmix64, of one number.
std::uint64_t mixed(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

std::int64_t drawn(std::int64_t most_us, std::uint64_t by) {
  const std::uint64_t bits = mixed(by);
  if (bits % 4 == 0) return most_us;
  return most_us * static_cast<std::int64_t>(300 + bits / 4 % 701) / 1000;
}

Node node_of(const xauto::XNodeSpec& spec, std::uint64_t seed, std::int64_t slack_us) {
  Node node(spec.name);
  for (const auto& [type, wcet_us] : spec.wcet_us)
    node.add_impl(
        xauto::XPU(type),
        [](const xauto::XpuId& id) {
          auto opened = xauto::emu::Context::open(id);
          if (!opened) throw std::runtime_error(opened.error().to_string());
          const xauto::SchedHandle handle = opened->handle();
          return xauto::own(std::make_unique<xauto::emu::Context>(std::move(*opened)), handle);
        },
        [most = wcet_us - slack_us, seed](xauto::emu::Context& context, State& state,
                                          const xauto::Input& input) {
          state.result.number = input.sequence();
          if (seed == 0) return context.run(std::chrono::microseconds(most));
          return context.run(
              std::chrono::microseconds(drawn(most, seed ^ mixed(input.sequence()))));
        });
  return node;
}

MessageTopic result_of(const std::string& module) {
  return MessageTopic("of/" + module);
}

void add_sources(xauto::App& app, const xauto::AppSpec& spec) {
  for (const xauto::SourceSpec& source : spec.sources)
    app.add_source(MessageTopic(source.name), std::chrono::microseconds(source.period.floor_us()),
                   [](std::uint64_t number) { return Message{number}; });
}

void add_modules(xauto::App& app, const xauto::AppSpec& spec, std::uint64_t seed,
                 std::int64_t slack_us) {
  const auto at = [&](int xnode) -> const xauto::XNodeSpec& {
    return spec.xnodes[static_cast<std::size_t>(xnode)];
  };
  std::map<std::string, std::vector<int>> xnodes;  // of each module, in their order
  for (const int x : spec.topological_order()) xnodes[at(x).module].push_back(x);
  const auto leads = [&](const std::pair<int, int>& edge) {  // from one module into another
    if (at(edge.first).module == at(edge.second).module) return false;
    if (xnodes[at(edge.first).module].back() != edge.first ||
        xnodes[at(edge.second).module].front() != edge.second)
      throw std::runtime_error("no program has an edge or sample like that from '" +
                               at(edge.first).name + "' to '" + at(edge.second).name + "'");
    return true;
  };
  for (const xauto::ModuleSpec& named : spec.modules) {
    Module module(named.name);
    module.in_flight(static_cast<int>(named.max_in_flight));
    for (const int x : xnodes[named.name])
      module.add_node(
          node_of(at(x), seed == 0 ? 0 : mixed(seed ^ static_cast<std::uint64_t>(x)), slack_us));
    for (const int source : at(xnodes[named.name].front()).sources)
      module.add_input_topic(MessageTopic(spec.sources[static_cast<std::size_t>(source)].name));
    for (const auto& edge : spec.edges)
      if (at(edge.second).module == named.name && leads(edge))
        module.add_input_topic(result_of(at(edge.first).module));
    for (const auto& sample : spec.samples)
      if (at(sample.second).module == named.name && leads(sample))
        module.add_sampled_topic(result_of(at(sample.first).module));
    module.add_output_topic(result_of(named.name), &State::result);
    app.add_module(module);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "usage: bench_standin APP SEED SLACK_US\n");
    return 2;
  }
  const auto spec = xauto::load_app(argv[1]);
  if (!spec) {
    std::fprintf(stderr, "bench_standin: %s\n", spec.error().to_string().c_str());
    return 2;
  }
  xauto::App app(spec->name);
  const std::uint64_t seed = std::strtoull(argv[2], nullptr, 10);
  add_sources(app, *spec);
  add_modules(app, *spec, seed, std::strtoll(argv[3], nullptr, 10));
  return app.main(argc, argv);
}

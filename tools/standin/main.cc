// SPDX-License-Identifier: Apache-2.0
// xauto-standin: the program of an app that is known by its app.json alone, as those of `xauto
// generate` are. Each XNode keeps an emulated XPU busy and calculates nothing; workers, coordinators
// and topics are those of any app.
//
// A job takes 60 to 95 % of its XNode's WCET there, as a stage takes less than its WCET on an
// ordinary day, and leaves the emulator 0.3 ms to wake up in: a short one takes less, 30 % at least.
// --worst: it takes all of it. --seed: one in four does, and the others 30 % and more. Either way less
// --slack. A time is drawn by XNode and release (and seed), so that it is the same under each policy.
//
// What a program can have: an edge into an XModule comes from the last XNode of another one and ends
// at its first; so do samples. What is otherwise is refused.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "cli/cli.h"
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

struct Flags {
  std::string app;
  bool worst = false;
  std::uint64_t seed = 0;  ///< 0: none
  double slack_us = 0;
};

/// How long the job takes that `bits` stand for, of an XNode of `wcet_us`.
std::int64_t time_of(const Flags& flags, std::int64_t wcet_us, std::uint64_t bits) {
  const auto most = std::max<std::int64_t>(1, wcet_us - static_cast<std::int64_t>(flags.slack_us));
  const auto part = [&](std::uint64_t low, std::uint64_t range) {
    return most * static_cast<std::int64_t>(low + bits / 4 % range) / 1000;
  };
  if (flags.worst) return most;
  if (flags.seed != 0) return bits % 4 == 0 ? most : part(300, 701);
  return std::min(part(600, 351), std::max(most * 30 / 100, most - 300));
}

Node node_of(const xauto::XNodeSpec& spec, int index, const Flags& flags) {
  Node node(spec.name);
  const std::uint64_t of_xnode = mixed(flags.seed ^ static_cast<std::uint64_t>(index));
  for (const auto& [type, wcet_us] : spec.wcet_us)
    node.add_impl(
        xauto::XPU(type),
        [](const xauto::XpuId& id) {
          auto opened = xauto::emu::Context::open(id);
          if (!opened) throw std::runtime_error(opened.error().to_string());
          const xauto::SchedHandle handle = opened->handle();
          return xauto::own(std::make_unique<xauto::emu::Context>(std::move(*opened)), handle);
        },
        [wcet = wcet_us, of_xnode, flags](xauto::emu::Context& context, State& state,
                                          const xauto::Input& input) {
          state.result.number = input.sequence();
          const std::uint64_t bits = mixed(of_xnode ^ mixed(input.sequence()));
          return context.run(std::chrono::microseconds(time_of(flags, wcet, bits)));
        });
  return node;
}

MessageTopic result_of(const std::string& module) {
  return MessageTopic("of/" + module);
}

void add_sources(xauto::App& app, const xauto::AppSpec& spec) {
  // Without rates the next release comes once the last has ended: here it is ready by then.
  for (const xauto::SourceSpec& source : spec.sources)
    app.add_source(MessageTopic(source.name),
                   std::chrono::microseconds(spec.one_at_a_time ? 1'000 : source.period.floor_us()),
                   [](std::uint64_t number) { return Message{number}; });
}

void add_modules(xauto::App& app, const xauto::AppSpec& spec, const Flags& flags) {
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
    for (const int x : xnodes[named.name]) module.add_node(node_of(at(x), x, flags));
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
  Flags flags;
  xauto::cli::Program program(
      "Stands in for an app's program: each XNode keeps an emulated XPU busy.", "xauto-standin");
  program.option("app", flags.app, "app.json").required();
  program.flag("--worst", flags.worst, "each job takes its WCET, not less");
  program.option("--seed", flags.seed, "one job in four takes its WCET, the others 30 % and more")
      .excludes("--worst");
  program.duration("--slack", flags.slack_us, xauto::cli::Unit::kMicroseconds, 0, 1e9,
                   "by which each job takes less");
  if (const auto exit = program.parse(argc, argv)) return *exit;
  const auto spec = xauto::load_app(flags.app);
  if (!spec) {
    std::fprintf(stderr, "xauto-standin: %s\n", spec.error().to_string().c_str());
    return 2;
  }
  try {
    xauto::App app(spec->name);
    add_sources(app, *spec);
    add_modules(app, *spec, flags);
    return app.main(argc, argv);
  } catch (const std::runtime_error& error) {
    std::fprintf(stderr, "xauto-standin: %s: %s\n", flags.app.c_str(), error.what());
    return 2;
  }
}

// SPDX-License-Identifier: Apache-2.0
// For keys_test.py: three modules on real CPUs, each with a source of its own. Each burns what its
// name says of CPU time, so that an order of ends is an order of who had the core.
//   long 20 ms of 50, short 2 ms of 50, slow 1 ms of 100
#include <cstdint>
#include <string>

#include <xauto/xauto.h>

#include "cpu_time.h"

namespace {

using namespace std::chrono_literals;

struct State {
  int done = 0;
};

void add(xauto::App& app, const std::string& name, std::chrono::microseconds period,
         std::chrono::nanoseconds burn) {
  const xauto::Topic<int> in(name), out(name + "/out");
  app.add_source(in, period, [](std::uint64_t k) { return static_cast<int>(k); });
  xauto::XNode<State> node(name + ".run");
  node.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [burn](State& state, const xauto::Input&) {
        for (const std::int64_t since = cpu_ns(); cpu_ns() - since < burn.count();) ++state.done;
      });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::App app("keysapp");
  add(app, "long", 50ms, 20ms);
  add(app, "short", 50ms, 2ms);
  add(app, "slow", 100ms, 1ms);
  return app.main(argc, argv);
}

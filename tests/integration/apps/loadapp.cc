// SPDX-License-Identifier: Apache-2.0
// For regulated_test.py and tests/vm/run-together: loadapp NAME PERIOD_US BURN_US EVERY TIMES: one module on a real core,
// whose jobs burn so much CPU time; of each EVERY-th job so many times that. EVERY 0: none.
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <string>

#include <xauto/xauto.h>

#include "cpu_time.h"

namespace {

struct State {
  int done = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6) return 2;
  const std::string name = argv[1];
  const std::int64_t burn_ns = std::atoll(argv[3]) * 1000;
  const int every = std::atoi(argv[4]), times = std::atoi(argv[5]);
  xauto::App app(name);
  const xauto::Topic<int> in(name + "_source"), out(name + "_out");
  app.add_source(in, std::chrono::microseconds(std::atoll(argv[2])),
                 [](std::uint64_t k) { return static_cast<int>(k); });
  xauto::XNode<State> node(name + "_step");
  node.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [=](State& state, const xauto::Input&) {
        const bool over = every > 0 && state.done % every == every - 1;
        const std::int64_t until = cpu_ns() + burn_ns * (over ? times : 1);
        while (cpu_ns() < until) {
        }
        ++state.done;
      });
  xauto::XModule<State> module(name + "_module");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
  return app.main(1, argv);
}

// SPDX-License-Identifier: Apache-2.0
// Three modules on one NVIDIA GPU, each a kernel in a context of its own, by about 1 ms at 100 Hz, 6 ms at 25 Hz and
// 40 ms at 5 Hz: the long one leaves the short one no time unless it is suspended. run.sh builds and runs it.
//
//   KERNELS=kernels.ptx app
#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include "stage.h"

namespace {

using namespace std::chrono_literals;
using nvidia::kPerMs;
using nvidia::Stage;

struct State {
  int done = 0;
};

void add(xauto::App& app, const std::string& name, std::chrono::milliseconds period,
         unsigned long long iterations) {
  const xauto::Topic<int> in(name), out(name + "/out");
  app.add_source(in, period, [](std::uint64_t k) { return static_cast<int>(k); });
  xauto::XNode<State> node(name + ".run");
  node.add_impl(
      xauto::XPU::GPU,
      [](const xauto::XpuId& xpu) {
        auto stage = std::make_unique<Stage>(xpu.index);
        const xauto::SchedHandle handle = stage->handle();
        return xauto::own(std::move(stage), handle);
      },
      [iterations](Stage& stage, State& state, const xauto::Input&) {
        ++state.done;
        return stage.work(iterations);
      });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::App app("gpus");
  add(app, "fast", 10ms, kPerMs);
  add(app, "mid", 40ms, 6 * kPerMs);
  add(app, "slow", 200ms, 40 * kPerMs);
  return app.main(argc, argv);
}

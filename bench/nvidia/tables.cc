// SPDX-License-Identifier: Apache-2.0
// Three modules, two of them only on an NVIDIA GPU and one on a CPU as well: who else uses the GPU decides where it is
// to be. tables.py builds and runs it.
//
//   KERNELS=kernels.ptx tables
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "stage.h"

namespace {

using namespace std::chrono_literals;
using nvidia::kPerMs;
using nvidia::Stage;

struct State {
  int done = 0;
  float sum = 0;
};

/// A unit is 1 to 3 ms of a CPU: each step waits for the one before.
xauto::Status compute(State& state, int units) {
  float x = state.sum;
  for (int i = 0; i < units * 370'000; ++i) x = x * 1.0001f + 0.5f;
  state.sum = x > 1e30f ? 0.0f : x;
  ++state.done;
  return {};
}

void add(xauto::App& app, const std::string& name, std::chrono::microseconds period, int gpu_ms,
         std::optional<int> cpu_ms = {}) {
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
      [iterations = kPerMs * static_cast<unsigned long long>(gpu_ms)](Stage& stage, State& state,
                                                                      const xauto::Input&) {
        ++state.done;
        return stage.work(iterations);
      });
  if (cpu_ms)
    node.add_impl(
        xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
        [units = *cpu_ms](State& state, const xauto::Input&) { return compute(state, units); });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::App app("shared-gpu");
  add(app, "brake", 33ms, 1);
  add(app, "detect", 33ms, 6, 5);
  add(app, "map", 198ms, 36);
  return app.main(argc, argv);
}

// SPDX-License-Identifier: Apache-2.0
// Three modules, two of them only on an NVIDIA GPU and one on a CPU as well: who else uses the GPU decides where it is
// to be. tables.py builds and runs it.
//
//   KERNELS=kernels.ptx tables
#include <chrono>
#include <optional>
#include <string>

#include "stage.h"

namespace {

using namespace std::chrono_literals;
using nvidia::kPerMs;

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

void add(xauto::App& app, const std::string& name, std::chrono::microseconds period,
         unsigned long long gpu_ms, std::optional<int> cpu_units = {}) {
  xauto::XNode<State> node(name + ".run");
  nvidia::run_on_gpu(node, kPerMs * gpu_ms);
  if (cpu_units)
    node.add_impl(
        xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
        [units = *cpu_units](State& state, const xauto::Input&) { return compute(state, units); });
  nvidia::add_module(app, name, period, node);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::App app("shared-gpu");
  add(app, "brake", 33ms, 1);
  add(app, "detect", 33ms, 6, 5);
  add(app, "map", 198ms, 36);
  return app.main(argc, argv);
}

// SPDX-License-Identifier: Apache-2.0
// Three modules on one NVIDIA GPU, each a kernel in a context of its own or on a stream of its level, by about 1 ms at
// 100 Hz, 6 ms at 25 Hz and 40 ms at 5 Hz: the long one leaves the short one no time unless it is suspended, or its
// blocks end soon (BLOCK_US). run.sh builds and runs it.
//
//   KERNELS=kernels.ptx app
#include <chrono>
#include <string>

#include "stage.h"

namespace {

using namespace std::chrono_literals;
using nvidia::kPerMs;

struct State {
  int done = 0;
};

void add(xauto::App& app, const std::string& name, std::chrono::milliseconds period,
         unsigned long long iterations, int by_hand) {
  xauto::XNode<State> node(name + ".run");
  nvidia::run_on_gpu(node, iterations, by_hand);
  nvidia::add_module(app, name, period, node);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::App app("gpus");
  add(app, "fast", 10ms, kPerMs, 2);
  add(app, "mid", 40ms, 6 * kPerMs, 1);
  add(app, "slow", 200ms, 40 * kPerMs, 0);
  return app.main(argc, argv);
}

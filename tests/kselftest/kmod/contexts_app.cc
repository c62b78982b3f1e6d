// SPDX-License-Identifier: Apache-2.0
// For contexts.sh: two modules, each with a context of its own, as CUDA makes them. It opens a
// second TSG in its first `exec`. In its own `slow` first waits until `quick`, which is more urgent,
// has preempted it, and the file GO is there; `quick` pauses meanwhile.
//
//   contexts_app GO [before]      before: main() makes both, slow's where nobody looks
#include <atomic>
#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>

#include <unistd.h>

#include <xauto/xauto.h>

#include "emu/driver_queue.h"

namespace {

using namespace std::chrono_literals;
using xauto::SchedHandle;
using xauto::emu::DriverQueue;

struct Cuda {
  std::optional<DriverQueue> compute, copies;

  static DriverQueue opened() {
    auto queue = DriverQueue::open_gpu();
    if (!queue) throw std::runtime_error(queue.error().to_string());
    return std::move(*queue);
  }
  SchedHandle make() {
    if (!compute) compute = opened();
    return SchedHandle::cuda_context(this);
  }
  xauto::Status run(std::chrono::milliseconds work) {
    XAUTO_TRY(compute->submit(work));
    const auto done = compute->wait();
    if (!done) return tl::unexpected(done.error());
    return {};
  }
};

struct State {
  int done = 0;
};

std::atomic<int> g_released{0}, g_quick{0};  ///< jobs of quick's; that have run
/// slow's first job has begun; one of quick's has begun since and is over (one that only ended
/// meanwhile may have begun before: then it was slow that preempted it); slow has its second TSG.
std::atomic<bool> g_waits{false}, g_preempted{false}, g_opened{false};

/// Until none of quick's jobs runs, either: what appears then would be nobody's.
void wait_for(const char* go) {
  g_waits = true;
  const auto alone = [&] { return g_preempted && g_quick == g_released && access(go, F_OK) == 0; };
  do {
    while (!alone()) std::this_thread::sleep_for(1ms);
    std::this_thread::sleep_for(100ms);  // what runs after quick's exec
  } while (!alone());
}

void add(xauto::App& app, const std::string& name, Cuda& cuda, std::chrono::milliseconds period,
         std::chrono::milliseconds work, const char* go) {
  const xauto::Topic<int> in(name), out(name + "/out");
  // slow's first job comes after quick's: what both opened in their first would be nobody's.
  app.add_source(in, period, [go](std::uint64_t k) {
    while (go != nullptr ? g_quick == 0 : g_preempted && !g_opened)
      std::this_thread::sleep_for(1ms);
    if (go == nullptr) ++g_released;
    return static_cast<int>(k);
  });
  xauto::XNode<State> node(name + ".run");
  node.add_impl(
      xauto::XPU::GPU, [&cuda](const xauto::XpuId&) { return cuda.make(); },
      [&cuda, work, go](State& state, const xauto::Input&) {
        const bool preempts = go == nullptr && g_waits;
        if (go != nullptr && !cuda.copies) wait_for(go);
        if (!cuda.copies) cuda.copies = Cuda::opened();
        if (go != nullptr) g_opened = true;
        ++state.done;
        const xauto::Status done = cuda.run(work);
        if (preempts) g_preempted = true;
        if (go == nullptr) ++g_quick;
        return done;
      });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  Cuda quick, slow;
  if (argc > 2) {
    xauto::make_context([&] { return quick.make(); });
    slow.make();
  }
  xauto::App app("contexts");
  add(app, "quick", quick, 50ms, 2ms, nullptr);
  add(app, "slow", slow, 2s, 30ms, argc > 1 ? argv[1] : nullptr);
  return app.main(argc, argv);
}

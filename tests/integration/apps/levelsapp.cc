// SPDX-License-Identifier: Apache-2.0
// Modules on the CUDA of tests/nvidia: on levels, or each in a context of its own. A block lasts for a time and computes
// nothing.
//
//   levelsapp LOG UNITS NAME:PERIOD_MS:KERNELS:BLOCKS:BLOCK_US...
//
// UNITS: how many blocks the GPU runs at a time. LOG gets a line for each job, of what the GPU knows of it: its name,
// its release, the priority of its stream, since and until when that had work, how many blocks of others ran when
// it came, and how many of its kernels waited for one.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <xauto/cuda.h>
#include <xauto/xauto.h>

#include "fake.h"

namespace {

using xauto::cuda::Context;

struct State {
  int done = 0;
};

struct Work {
  std::string name;
  int period_ms = 0, kernels = 0, blocks = 0, block_us = 0;

  explicit Work(const std::string& text) : name(text.substr(0, text.find(':'))) {
    if (std::sscanf(text.c_str() + name.size(), ":%d:%d:%d:%d", &period_ms, &kernels, &blocks,
                    &block_us) != 4)
      throw std::runtime_error("no work: " + text);
  }
};

std::FILE* g_log = nullptr;

xauto::Status run(Context& context, const Work& work, int release) {
  const Context::Scope scope(context);
  XAUTO_TRY(scope.entered());
  const auto block = [&] { std::this_thread::sleep_for(std::chrono::microseconds(work.block_us)); };
  for (int i = 0; i < work.kernels; ++i)
    if (!fake::enqueue(context.stream(), block, work.blocks))
      return xauto::fail(xauto::ErrorCode::kInternal, "it is another context's stream");
  XAUTO_TRY(context.synchronize());
  const fake::Busy busy = fake::last_busy(context.stream());
  std::fprintf(g_log, "%s %d %d %lld %lld %d %d\n", work.name.c_str(), release,
               fake::priority_of(context.stream()), static_cast<long long>(busy.since_ns),
               static_cast<long long>(busy.until_ns), busy.met, busy.waits);
  return {};
}

void add(xauto::App& app, const Work& work) {
  const xauto::Topic<int> in(work.name), out(work.name + "/out");
  app.add_source(in, std::chrono::milliseconds(work.period_ms),
                 [](std::uint64_t k) { return static_cast<int>(k); });
  xauto::XNode<State> node(work.name + ".run");
  node.add_impl(
      xauto::XPU::GPU,
      [](const xauto::XpuId& xpu) {
        auto made = Context::create(xpu);
        if (!made) throw std::runtime_error(made.error().to_string());
        const xauto::SchedHandle handle = (*made)->handle();
        return xauto::own(std::move(*made), handle);
      },
      [work, in](Context& context, State& state, const xauto::Input& input) {
        ++state.done;
        return run(context, work, input.get(in));
      });
  xauto::XModule<State> module(work.name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) return 2;
  g_log = std::fopen(argv[1], "a");
  if (g_log == nullptr) return 2;
  std::setvbuf(g_log, nullptr, _IOLBF, BUFSIZ);
  const fake::Device gpu(std::atoi(argv[2]));
  xauto::App app("levels");
  for (int i = 3; i < argc; ++i) add(app, Work(argv[i]));
  const int status = app.main(argc, argv);
  std::fclose(g_log);
  return status;
}

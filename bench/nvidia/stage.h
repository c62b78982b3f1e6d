// SPDX-License-Identifier: Apache-2.0
// What app.cc and tables.cc run on a GPU: the kernel `work` of kernels.cu, in a context of its own.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include <xauto/cuda.h>
#include <xauto/xauto.h>

namespace nvidia {

constexpr unsigned long long kPerMs = 320'000;  // an H100 at 1980 MHz

using xauto::cuda::checked;
using xauto::cuda::Context;

inline void must(CUresult done, const char* call) {
  if (const xauto::Status status = checked(done, call); !status)
    throw std::runtime_error(status.error().to_string());
}

inline const std::string& kernels() {
  static const std::string ptx = [] {
    const char* path = std::getenv("KERNELS");
    std::ifstream file(path != nullptr ? path : "kernels.ptx");
    return std::string(std::istreambuf_iterator<char>(file), {});
  }();
  return ptx;
}

/// A context with the kernel `work` in it.
class Stage {
 public:
  /// `by_hand`: with HAND_LEVELS=1 the app orders its work itself, on this of three levels.
  Stage(const xauto::XpuId& xpu, int by_hand) {
    const bool hand = std::getenv("HAND_LEVELS") != nullptr;
    auto made = hand ? Context::create(xpu.index, 3) : Context::create(xpu);
    if (!made) throw std::runtime_error(made.error().to_string());
    context_ = std::move(made.value());
    if (const xauto::Status taken = hand ? context_->take(by_hand) : xauto::Status(); !taken)
      throw std::runtime_error(taken.error().to_string());
    const Context::Scope scope(*context_);
    CUmodule module = nullptr;
    must(cuModuleLoadData(&module, kernels().c_str()), "cuModuleLoadData");
    must(cuModuleGetFunction(&work_, module, "work"), "cuModuleGetFunction");
    must(cuMemAlloc(&out_, sizeof(float)), "cuMemAlloc");
  }
  [[nodiscard]] xauto::SchedHandle handle() const { return context_->handle(); }
  /// Returns when it is over, as an exec has to.
  xauto::Status work(unsigned long long iterations) {
    const Context::Scope scope(*context_);
    XAUTO_TRY(scope.entered());
    // As much work in so many more blocks, where they are to be short: what is more urgent waits for those that run.
    const unsigned long long longest = block_us() * kPerMs / 1000;
    const auto times = longest == 0 ? 1 : (iterations + longest - 1) / longest;
    iterations /= times;
    void* arguments[] = {&iterations, &out_};
    XAUTO_TRY(checked(cuLaunchKernel(work_, static_cast<unsigned>(264 * times), 1, 1, 256, 1, 1, 0,
                                     context_->stream(), arguments, nullptr),
                      "cuLaunchKernel"));
    return context_->synchronize();
  }

 private:
  /// BLOCK_US; 0: a block takes as long as the kernel.
  static unsigned long long block_us() {
    const char* us = std::getenv("BLOCK_US");
    return us == nullptr ? 0 : std::strtoull(us, nullptr, 10);
  }
  std::unique_ptr<Context> context_;
  CUfunction work_ = nullptr;
  CUdeviceptr out_ = 0;
};

/// A job of it counts in State::done.
template <class State>
void run_on_gpu(xauto::XNode<State>& node, unsigned long long iterations, int by_hand = 0) {
  node.add_impl(
      xauto::XPU::GPU,
      [by_hand](const xauto::XpuId& xpu) {
        auto stage = std::make_unique<Stage>(xpu, by_hand);
        const xauto::SchedHandle handle = stage->handle();
        return xauto::own(std::move(stage), handle);
      },
      [iterations](Stage& stage, State& state, const xauto::Input&) {
        ++state.done;
        return stage.work(iterations);
      });
}

/// A module of this node alone, with a source of its own.
template <class State>
void add_module(xauto::App& app, const std::string& name, std::chrono::microseconds period,
                const xauto::XNode<State>& node) {
  const xauto::Topic<int> in(name), out(name + "/out");
  app.add_source(in, period, [](std::uint64_t k) { return static_cast<int>(k); });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace nvidia

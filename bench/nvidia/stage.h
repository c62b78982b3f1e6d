// SPDX-License-Identifier: Apache-2.0
// What app.cc and tables.cc run on a GPU: the kernel `work` of kernels.cu, in a context of its own.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include <dlfcn.h>

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

/// Who orders the work of several stages: ORDER of the environment.
enum class Order {
  kRuntime,  ///< XAuto, as the platform file says
  kHand,     ///< the app: a stream of a fixed priority for each stage
  kNobody,   ///< streams of one priority in one context
  kXsched,  ///< XSched in this process, highest priority first: its libraries, where they are installed
};

inline Order order() {
  const char* name = std::getenv("ORDER");
  if (name == nullptr) return Order::kRuntime;
  const std::string_view by = name;
  if (by == "hand") return Order::kHand;
  if (by == "nobody") return Order::kNobody;
  if (by == "xsched") return Order::kXsched;
  throw std::runtime_error("ORDER is hand, nobody or xsched, not '" + std::string(by) + "'");
}

/// A number of us of the environment; 0: not set.
inline unsigned long long us_of(const char* name) {
  const char* us = std::getenv(name);
  return us == nullptr ? 0 : std::strtoull(us, nullptr, 10);
}

/// XSched's queue on `stream` (its public API, by name: https://github.com/XpuOS/xsched, include/xsched). Its calls
/// return 0 where they went well.
inline void under_xsched(CUstream stream, int priority) {
  using Handle = std::uint64_t;
  void* hal = dlopen("libhalcuda.so", RTLD_NOW | RTLD_GLOBAL);
  if (hal == nullptr) throw std::runtime_error(std::string("XSched is not here: ") + dlerror());
  const auto call = [hal](const char* name, auto signature, auto... arguments) {
    void* found = dlsym(RTLD_DEFAULT, name);
    if (found == nullptr) found = dlsym(hal, name);
    if (found == nullptr) throw std::runtime_error(std::string("XSched has no ") + name);
    if (const int failed = reinterpret_cast<decltype(signature)>(found)(arguments...); failed != 0)
      throw std::runtime_error(std::string(name) + " of XSched fails with " +
                               std::to_string(failed));
  };
  constexpr int kLocal = 2, kHighestPriorityFirst = 1;
  constexpr std::int64_t kBlocks = 1;  // its level 1, which is what it has on this GPU
  static std::once_flag once;
  std::call_once(once, [&] {
    call("XHintSetScheduler", static_cast<int (*)(int, int)>(nullptr), kLocal,
         kHighestPriorityFirst);
  });
  Handle hardware = 0, queue = 0;
  call("CudaQueueCreate", static_cast<int (*)(Handle*, CUstream)>(nullptr), &hardware, stream);
  call("XQueueCreate", static_cast<int (*)(Handle*, Handle, std::int64_t, std::int64_t)>(nullptr),
       &queue, hardware, kBlocks, std::int64_t{0});
  // Launches that may be on the GPU at a time, and after how many it looks again.
  const auto most = static_cast<std::int64_t>(us_of("XSCHED_LAUNCHES"));
  if (most > 0)
    call("XQueueSetLaunchConfig", static_cast<int (*)(Handle, std::int64_t, std::int64_t)>(nullptr),
         queue, most, (most + 1) / 2);
  call("XHintPriority", static_cast<int (*)(Handle, std::int32_t)>(nullptr), queue,
       std::int32_t{priority});
}

/// A context, and the stream of each job in it.
class Place {
 public:
  /// `by_hand`: on this of three levels, if it is not the runtime that orders work.
  Place(const xauto::XpuId& xpu, int by_hand) {
    const Order by = order();
    auto made = by == Order::kRuntime ? Context::create(xpu) : Context::create(xpu.index, 3);
    if (!made) throw std::runtime_error(made.error().to_string());
    context_ = std::move(made.value());
    if (by == Order::kRuntime) return;
    if (by == Order::kHand) {
      if (const xauto::Status taken = context_->take(by_hand); !taken)
        throw std::runtime_error(taken.error().to_string());
      own_ = context_->stream();
      return;
    }
    const Context::Scope scope(*context_);
    must(cuStreamCreate(&own_, CU_STREAM_NON_BLOCKING), "cuStreamCreate");
    if (by == Order::kXsched) under_xsched(own_, by_hand);
  }
  [[nodiscard]] Context& context() const { return *context_; }
  [[nodiscard]] xauto::SchedHandle handle() const { return context_->handle(); }
  [[nodiscard]] CUstream stream() const { return own_ != nullptr ? own_ : context_->stream(); }
  [[nodiscard]] xauto::Status synchronize() const {
    return checked(cuStreamSynchronize(stream()), "cuStreamSynchronize");
  }

 private:
  std::unique_ptr<Context> context_;
  CUstream own_ = nullptr;  ///< null: the context's of the job
};

/// A place with the kernel `work` in it.
class Stage {
 public:
  Stage(const xauto::XpuId& xpu, int by_hand) : place_(xpu, by_hand) {
    const Context::Scope scope(place_.context());
    CUmodule module = nullptr;
    must(cuModuleLoadData(&module, kernels().c_str()), "cuModuleLoadData");
    must(cuModuleGetFunction(&work_, module, "work"), "cuModuleGetFunction");
    if (us_of("BLOCK_US") > 0)
      must(cuFuncSetAttribute(work_, CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES, kShared),
           "cuFuncSetAttribute");
    must(cuMemAlloc(&out_, sizeof(float)), "cuMemAlloc");
  }
  [[nodiscard]] xauto::SchedHandle handle() const { return place_.handle(); }
  /// Returns when it is over, as an exec has to.
  xauto::Status work(unsigned long long iterations) {
    const Context::Scope scope(place_.context());
    XAUTO_TRY(scope.entered());
    // As much work in more blocks, where they are to be short: what is more urgent waits for those that run. And in
    // launches of so long each, as the layers of a net are.
    static const unsigned long long block_us = us_of("BLOCK_US"), launch_us = us_of("LAUNCH_US");
    const unsigned long long block = block_us == 0 ? iterations : block_us * kPerMs / 1000;
    unsigned long long blocks = (iterations + block - 1) / block;
    iterations /= blocks;
    const unsigned long long at_once =
        launch_us == 0 || block_us == 0 ? blocks : std::max(1ull, launch_us / block_us);
    void* arguments[] = {&iterations, &out_};
    for (; blocks > 0; blocks -= std::min(blocks, at_once))
      XAUTO_TRY(checked(
          cuLaunchKernel(work_, static_cast<unsigned>(264 * std::min(blocks, at_once)), 1, 1, 256,
                         1, 1, block_us == 0 ? 0 : kShared, place_.stream(), arguments, nullptr),
          "cuLaunchKernel"));
    return place_.synchronize();
  }

 private:
  /// What a block takes of an SM's memory, so that two are there at a time (of 228 KiB) and not eight: a block takes
  /// BLOCK_US whatever waits.
  static constexpr int kShared = 96 * 1024;
  Place place_;
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

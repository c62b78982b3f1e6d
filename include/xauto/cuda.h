// SPDX-License-Identifier: Apache-2.0
// Where an XNode's work on a GPU goes, by CUDA's driver API: a context that can be suspended, or streams of the levels
// on which its jobs are started. tensorrt.h, cuda_graph.h and cudla.h stand on it.
// Only for apps that have CUDA (cuda.h, libcuda). Run on an H100 with CUDA 13: bench/nvidia.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <cuda.h>

#include <xauto/result.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>

/// CUDA contexts: cuda.h.
namespace xauto::cuda {

/// An error of CUDA's as ours; `call` becomes its `where`.
[[nodiscard]] inline Status checked(CUresult result, const char* call) {
  if (result == CUDA_SUCCESS) return {};
  const char* text = nullptr;
  if (cuGetErrorString(result, &text) != CUDA_SUCCESS || text == nullptr) text = "unknown error";
  return fail(ErrorCode::kUnavailable,
              "CUDA error " + std::to_string(static_cast<int>(result)) + ": " + text, call);
}

namespace detail {

/// The GPU's own context, and a stream of it for each priority level: what all XNodes of a process share where jobs
/// are started by levels. One stream for each, since a GPU has few queues (CUDA_DEVICE_MAX_CONNECTIONS, 8 if nobody
/// says otherwise), and streams that share one wait for each other.
class Streams {
 public:
  /// Of GPU `index`, `levels` of them: the highest that there are. Error: kInvalid where it has fewer.
  [[nodiscard]] static Result<std::shared_ptr<Streams>> of(int index, int levels) {
    static std::mutex mutex;  // std::mutex, since lib/base/mutex.h is not installed
    static std::map<std::pair<int, int>, std::weak_ptr<Streams>> known;
    const std::lock_guard lock(mutex);
    std::weak_ptr<Streams>& there = known[{index, levels}];
    if (std::shared_ptr<Streams> streams = there.lock()) return streams;
    std::shared_ptr<Streams> made(new Streams);
    XAUTO_TRY(made->make(index, levels));
    there = made;
    return made;
  }
  Streams(const Streams&) = delete;
  Streams& operator=(const Streams&) = delete;
  ~Streams() {
    if (context_ == nullptr) return;
    if (cuCtxPushCurrent(context_) == CUDA_SUCCESS) {
      for (CUstream stream : by_level_) cuStreamDestroy(stream);
      CUcontext popped = nullptr;
      cuCtxPopCurrent(&popped);
    }
    cuDevicePrimaryCtxRelease(device_);
  }

  [[nodiscard]] CUcontext context() const { return context_; }
  [[nodiscard]] const std::vector<CUstream>& by_level() const { return by_level_; }

 private:
  Streams() = default;

  [[nodiscard]] Status make(int index, int levels) {
    XAUTO_TRY(checked(cuInit(0), "cuInit"));
    XAUTO_TRY(checked(cuDeviceGet(&device_, index), "cuDeviceGet"));
    XAUTO_TRY(checked(cuDevicePrimaryCtxRetain(&context_, device_), "cuDevicePrimaryCtxRetain"));
    XAUTO_TRY(checked(cuCtxPushCurrent(context_), "cuCtxPushCurrent"));
    const Status done = make_streams(levels);
    CUcontext popped = nullptr;
    cuCtxPopCurrent(&popped);
    return done;
  }

  [[nodiscard]] Status make_streams(int levels) {
    int least = 0, greatest = 0;  // the greatest priority is the smallest number
    XAUTO_TRY(
        checked(cuCtxGetStreamPriorityRange(&least, &greatest), "cuCtxGetStreamPriorityRange"));
    if (const int there = least - greatest + 1; there < levels)
      return fail(
          ErrorCode::kInvalid,
          "the GPU has " + std::to_string(there) +
              " stream priorities, and the platform file says \"levels\": " +
              std::to_string(levels),
          "cuCtxGetStreamPriorityRange",
          there < 2 ? "plan without \"levels\"" : "plan with \"levels\": " + std::to_string(there));
    for (int level = 0; level < levels; ++level) {
      CUstream stream = nullptr;
      XAUTO_TRY(checked(cuStreamCreateWithPriority(&stream, CU_STREAM_NON_BLOCKING,
                                                   greatest + levels - 1 - level),
                        "cuStreamCreateWithPriority"));
      by_level_.push_back(stream);
    }
    return {};
  }

  CUdevice device_ = 0;
  CUcontext context_ = nullptr;
  std::vector<CUstream> by_level_;
};

}  // namespace detail

/// Where an XNode's work on a GPU goes: a context of its own with one stream, which is what the runtime suspends; or,
/// where it starts jobs by levels (xauto::levels), the GPU's own context and the stream of the level that the job
/// needs. Threads: one at a time; each makes the context current (Scope) before it calls CUDA.
class Context {
 public:
  /// On GPU `index`, by so many levels; 0: of its own. Errors: kUnavailable, with CUDA's words; kInvalid: the GPU has
  /// fewer stream priorities.
  [[nodiscard]] static Result<std::unique_ptr<Context>> create(int index, int levels = 0) {
    std::unique_ptr<Context> made(new Context);
    if (levels > 0) {
      XAUTO_ASSIGN(made->shared_, detail::Streams::of(index, levels));
      made->context_ = made->shared_->context();
      made->stream_ = made->shared_->by_level().front();
      return made;
    }
    XAUTO_TRY(checked(cuInit(0), "cuInit"));
    CUdevice device = 0;
    XAUTO_TRY(checked(cuDeviceGet(&device, index), "cuDeviceGet"));
#if CUDA_VERSION >= 13000
    XAUTO_TRY(checked(cuCtxCreate(&made->context_, nullptr, 0, device), "cuCtxCreate"));
#else
    XAUTO_TRY(checked(cuCtxCreate(&made->context_, 0, device), "cuCtxCreate"));
#endif
    const CUresult stream = cuStreamCreate(&made->stream_, CU_STREAM_NON_BLOCKING);
    CUcontext popped = nullptr;  // cuCtxCreate has made it current
    XAUTO_TRY(checked(cuCtxPopCurrent(&popped), "cuCtxPopCurrent"));
    XAUTO_TRY(checked(stream, "cuStreamCreate"));
    return made;
  }
  /// In an `init`: on this instance, as the run orders its jobs.
  [[nodiscard]] static Result<std::unique_ptr<Context>> create(const XpuId& xpu) {
    return create(xpu.index, levels(xpu));
  }
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;
  ~Context() {
    if (shared_ == nullptr && context_ != nullptr) cuCtxDestroy(context_);  // with its stream
  }

  /// While it lives, the context is current on this thread.
  class Scope {
   public:
    /// Makes it current; entered() tells whether that went well.
    explicit Scope(const Context& context) : entered_(cuCtxPushCurrent(context.context_)) {}
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;
    ~Scope() {
      CUcontext popped = nullptr;
      if (entered_ == CUDA_SUCCESS) cuCtxPopCurrent(&popped);
    }
    /// Whether it is.
    [[nodiscard]] Status entered() const { return checked(entered_, "cuCtxPushCurrent"); }

   private:
    CUresult entered_;
  };

  /// CUDA's handle.
  [[nodiscard]] CUcontext get() const {
    return context_;
  }
  /// Where this job's work goes; it waits for no other stream. By levels it may be another one for each job, and the
  /// same as that of an XNode which runs at another time: so nothing may be left on it when `exec` returns.
  [[nodiscard]] CUstream stream() const {
    return stream_;
  }
  /// Waits until the stream is empty.
  [[nodiscard]] Status synchronize() const {
    return checked(cuStreamSynchronize(stream_), "cuStreamSynchronize");
  }
  /// From now on stream() is that of this level, 0 being the lowest: what the runtime does before each job. An app
  /// that orders its work itself may, too. Error: kInvalid: there is no such level.
  [[nodiscard]] Status take(int level) {
    const std::size_t there = shared_ == nullptr ? 0 : shared_->by_level().size();
    if (level < 0 || static_cast<std::size_t>(level) >= there)
      return fail(ErrorCode::kInvalid,
                  "there are " + std::to_string(there) +
                      " levels, and this is none of them: " + std::to_string(level));
    stream_ = shared_->by_level()[static_cast<std::size_t>(level)];
    return {};
  }
  /// What `init` returns. The context must outlive the run; own() sees to that.
  [[nodiscard]] SchedHandle handle() {
    if (shared_ == nullptr) return SchedHandle::cuda_context(context_);
    return SchedHandle::on_levels([this](int level) { return take(level); });
  }

 private:
  Context() = default;
  std::shared_ptr<detail::Streams> shared_;  ///< by levels
  CUcontext context_ = nullptr;
  CUstream stream_ = nullptr;
};

namespace detail {

/// The `init` of an XNode that owns a Session of `model`, on the device of the XPU instance's index.
template <class Session, class Model>
[[nodiscard]] auto loader(Model model) {
  return [model = std::move(model)](const XpuId& xpu) {
    Result<std::unique_ptr<Session>> session = Session::open(model, xpu);
    if (!session) throw std::runtime_error(session.error().to_string());
    const SchedHandle handle = session.value()->handle();
    return own(std::move(session).value(), handle);
  };
}

}  // namespace detail

}  // namespace xauto::cuda

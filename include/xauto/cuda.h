// SPDX-License-Identifier: Apache-2.0
// A CUDA context and stream of one XNode's own, by CUDA's driver API: what tensorrt.h and cudla.h stand on.
// Only for apps that have CUDA (cuda.h, libcuda). Run on an H100 with CUDA 13: bench/nvidia.
#pragma once

#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

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

/// A context with one stream. A context is what the runtime suspends, so each XNode has one of its own
/// (SchedHandle::cuda_context). Threads: one at a time; each makes it current (Scope) before it calls CUDA.
class Context {
 public:
  /// On GPU `index`. Error: kUnavailable, with CUDA's words.
  [[nodiscard]] static Result<std::unique_ptr<Context>> create(int index) {
    XAUTO_TRY(checked(cuInit(0), "cuInit"));
    CUdevice device = 0;
    XAUTO_TRY(checked(cuDeviceGet(&device, index), "cuDeviceGet"));
    std::unique_ptr<Context> made(new Context);
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
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;
  ~Context() {
    if (context_ != nullptr) cuCtxDestroy(context_);  // with its stream
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
  /// Its stream, which waits for no other.
  [[nodiscard]] CUstream stream() const {
    return stream_;
  }
  /// Waits until the stream is empty.
  [[nodiscard]] Status synchronize() const {
    return checked(cuStreamSynchronize(stream_), "cuStreamSynchronize");
  }

 private:
  Context() = default;
  CUcontext context_ = nullptr;
  CUstream stream_ = nullptr;
};

namespace detail {

/// The `init` of an XNode that owns a Session of `model`, on the device of the XPU instance's index.
template <class Session, class Model>
[[nodiscard]] auto loader(Model model) {
  return [model = std::move(model)](const XpuId& xpu) {
    Result<std::unique_ptr<Session>> session = Session::open(model, xpu.index);
    if (!session) throw std::runtime_error(session.error().to_string());
    const SchedHandle handle = session.value()->handle();
    return own(std::move(session).value(), handle);
  };
}

}  // namespace detail

}  // namespace xauto::cuda

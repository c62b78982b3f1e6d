// SPDX-License-Identifier: Apache-2.0
// An XNode from a TensorRT plan, on a GPU. Only for apps that have TensorRT 8.5 or newer (NvInfer.h,
// libnvinfer) and CUDA (cuda.h, libcuda). Compiled and tested against declarations written from NVIDIA's
// documentation; not run on hardware yet.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <NvInfer.h>

#include <xauto/cuda.h>
#include <xauto/result.h>
#include <xauto/tensor.h>
#include <xauto/xpu.h>

/// XNodes from TensorRT plans: tensorrt.h.
namespace xauto::tensorrt {

/// Which plan, and what the app counts on.
struct Model {
  std::string file;  ///< path of the plan, as `trtexec --saveEngine` writes it
  /// As onnx::Model::inputs: names, types, shapes. Empty: all of the plan's.
  std::vector<TensorSpec> inputs = {};
  std::vector<TensorSpec> outputs = {};  ///< likewise
};

namespace detail {

/// Keeps what TensorRT said last of an error, for ours.
class Logger final : public nvinfer1::ILogger {
 public:
  void log(Severity severity, const char* message) noexcept override {
    if (severity > Severity::kERROR) return;
    const std::lock_guard lock(mutex_);
    std::strncpy(text_, message, sizeof text_ - 1);  // no allocation where nothing may be thrown
  }
  [[nodiscard]] std::string text() const {
    const std::lock_guard lock(mutex_);
    return text_[0] == '\0' ? "no reason is told" : text_;
  }

 private:
  // TensorRT has threads of its own. std::mutex, since lib/base/mutex.h is not installed.
  mutable std::mutex mutex_;
  char text_[1024] = {};
};

inline Result<ElementType> element_type(nvinfer1::DataType type, const std::string& name,
                                        const std::string& where) {
  switch (static_cast<int>(type)) {
    case static_cast<int>(nvinfer1::DataType::kFLOAT):
      return ElementType::kFloat32;
    case static_cast<int>(nvinfer1::DataType::kHALF):
      return ElementType::kFloat16;
    case static_cast<int>(nvinfer1::DataType::kINT8):
      return ElementType::kInt8;
    case static_cast<int>(nvinfer1::DataType::kINT32):
      return ElementType::kInt32;
    case static_cast<int>(nvinfer1::DataType::kBOOL):
      return ElementType::kBool;
    case static_cast<int>(nvinfer1::DataType::kUINT8):
      return ElementType::kUint8;
    case 8:
      return ElementType::kInt64;  // kINT64, which TensorRT 8 has no name for
    default:
      return fail(ErrorCode::kInvalid,
                  "\"" + name + "\" has elements of TensorRT's type " +
                      std::to_string(static_cast<int>(type)),
                  where,
                  "build the plan with float32, float16 or integers at its inputs and outputs");
  }
}

}  // namespace detail

/// A loaded plan with its buffers, in a CUDA context of its own, or on the levels of one that is shared (cuda.h).
/// Threads: one at a time.
///
/// Inputs and outputs are pinned memory that CPU and GPU share. On a Jetson, whose GPU has no other
/// memory, nothing is copied; a discrete GPU reads them over its bus.
class Session {
 public:
  /// Loads the plan on GPU `index`, by levels as cuda::Context::create; compares it with what the app counts on, makes
  /// the buffers, and runs once on zeros. Errors: kNotFound: no such file; kInvalid: other tensors, or a plan of another version
  /// or GPU, with TensorRT's words; kUnavailable: CUDA's own.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(Model model, int index = 0,
                                                             int levels = 0) {
    std::unique_ptr<Session> made(new Session(std::move(model)));
    XAUTO_ASSIGN(made->cuda_, cuda::Context::create(index, levels));
    const cuda::Context::Scope scope(*made->cuda_);
    XAUTO_TRY(scope.entered());
    XAUTO_TRY(made->load());
    XAUTO_TRY(made->bind());
    XAUTO_TRY(made->run());
    return made;
  }
  /// In an `init`: on this instance, as the run orders its jobs.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(Model model, const XpuId& xpu) {
    return open(std::move(model), xpu.index, xauto::levels(xpu));
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
  ~Session() {
    if (cuda_ == nullptr) return;
    const cuda::Context::Scope scope(*cuda_);  // all of it belongs to the context
    execution_.reset();
    engine_.reset();
    runtime_.reset();
    for (const Buffer& buffer : buffers_) cuMemFreeHost(buffer.host);
  }

  /// As agreed between app and plan.
  [[nodiscard]] std::span<const TensorSpec> inputs() const { return inputs_; }
  /// As agreed.
  [[nodiscard]] std::span<const TensorSpec> outputs() const { return outputs_; }
  /// As onnx::Session::input().
  template <class T>
  [[nodiscard]] std::span<T> input(std::size_t index) {
    (void)xauto::detail::tensor_at<T>(inputs_, index, "input");
    return {static_cast<T*>(buffers_[index].host), buffers_[index].bytes / sizeof(T)};
  }
  /// As onnx::Session::output().
  template <class T>
  [[nodiscard]] std::span<const T> output(std::size_t index) const {
    (void)xauto::detail::tensor_at<T>(outputs_, index, "output");
    const Buffer& buffer = buffers_[inputs_.size() + index];
    return {static_cast<const T*>(buffer.host), buffer.bytes / sizeof(T)};
  }

  /// Computes all outputs from the inputs, and waits for the GPU. Error: kUnavailable.
  [[nodiscard]] Status run() {
    const cuda::Context::Scope scope(*cuda_);
    XAUTO_TRY(scope.entered());
    if (!execution_->enqueueV3(reinterpret_cast<cudaStream_t>(cuda_->stream())))
      return fail(ErrorCode::kUnavailable, "TensorRT: " + logger_.text(), model_.file);
    return cuda_->synchronize();
  }

  /// Behind which all of its work is queued.
  [[nodiscard]] SchedHandle handle() const { return cuda_->handle(); }

 private:
  struct Buffer {
    void* host = nullptr;
    std::size_t bytes = 0;
  };
  explicit Session(Model model) : model_(std::move(model)) {}

  [[nodiscard]] Error refused(std::string hint) const {
    return {ErrorCode::kInvalid, "TensorRT: " + logger_.text(), model_.file, std::move(hint)};
  }

  [[nodiscard]] Status load() {
    XAUTO_ASSIGN(const std::vector<char> plan, xauto::detail::whole_file(model_.file));
    runtime_.reset(nvinfer1::createInferRuntime(logger_));
    if (runtime_ != nullptr)
      engine_.reset(runtime_->deserializeCudaEngine(plan.data(), plan.size()));
    if (engine_ != nullptr) execution_.reset(engine_->createExecutionContext());
    if (execution_ == nullptr)
      return tl::unexpected<Error>(
          refused("a plan runs only with the TensorRT and on the GPU that it was built with"));
    return {};
  }

  static std::vector<std::int64_t> shape_of(const nvinfer1::Dims& dims) {
    return {dims.d, dims.d + dims.nbDims};
  }

  [[nodiscard]] Status bind() {
    std::vector<TensorSpec> has_inputs, has_outputs;
    for (int i = 0; i < engine_->getNbIOTensors(); ++i) {
      const char* name = engine_->getIOTensorName(i);
      if (engine_->getTensorFormat(name) != nvinfer1::TensorFormat::kLINEAR)
        return fail(ErrorCode::kInvalid, std::string("\"") + name + "\" is not in linear order",
                    model_.file,
                    "build the plan with --inputIOFormats and --outputIOFormats of chw");
      if (engine_->getTensorLocation(name) != nvinfer1::TensorLocation::kDEVICE)
        return fail(ErrorCode::kInvalid, std::string("\"") + name + "\" is a shape, not data",
                    model_.file, "build the plan with shapes that are not inputs or outputs");
      XAUTO_ASSIGN(const ElementType type,
                   detail::element_type(engine_->getTensorDataType(name), name, model_.file));
      const bool input = engine_->getTensorIOMode(name) == nvinfer1::TensorIOMode::kINPUT;
      (input ? has_inputs : has_outputs)
          .push_back({name, type, shape_of(engine_->getTensorShape(name))});
    }
    XAUTO_ASSIGN(inputs_, xauto::detail::agreed(model_.inputs, has_inputs, "input", model_.file));
    for (const TensorSpec& spec : inputs_) {
      nvinfer1::Dims dims{};
      dims.nbDims = static_cast<std::int32_t>(spec.shape.size());
      for (std::size_t i = 0; i < spec.shape.size(); ++i)
        dims.d[i] = static_cast<std::remove_reference_t<decltype(dims.d[i])>>(spec.shape[i]);
      if (!xauto::detail::is_known(spec.shape) ||
          !execution_->setInputShape(spec.name.c_str(), dims))
        return fail(
            ErrorCode::kInvalid,
            "the plan takes no input \"" + spec.name + "\" of " + xauto::detail::text_of(spec),
            model_.file, "state a shape in Model::inputs that the plan was built for");
    }
    // With all inputs known, what an output's shape leaves open depends on the data.
    for (TensorSpec& spec : has_outputs)
      spec.shape = shape_of(execution_->getTensorShape(spec.name.c_str()));
    XAUTO_ASSIGN(const std::vector<TensorSpec> asked,
                 xauto::detail::agreed(model_.outputs, has_outputs, "output", model_.file));
    outputs_ = asked;
    for (const TensorSpec& spec : inputs_) XAUTO_TRY(add_buffer(spec));
    for (const TensorSpec& spec : outputs_) XAUTO_TRY(add_buffer(spec));
    // TensorRT writes every output, asked for or not.
    for (const TensorSpec& spec : has_outputs) {
      bool bound = false;
      for (const TensorSpec& other : outputs_) bound = bound || other.name == spec.name;
      if (!bound) XAUTO_TRY(add_buffer(spec));
    }
    return {};
  }

  [[nodiscard]] Status add_buffer(const TensorSpec& spec) {
    if (!xauto::detail::is_known(spec.shape))
      return fail(ErrorCode::kInvalid,
                  "the size of \"" + spec.name + "\" depends on the data (" +
                      xauto::detail::text_of(spec) + ")",
                  model_.file, "end the net before that operator");
    XAUTO_ASSIGN(const std::size_t bytes, xauto::detail::bytes_of(spec, model_.file));
    void* host = nullptr;
    XAUTO_TRY(
        cuda::checked(cuMemHostAlloc(&host, bytes == 0 ? 1 : bytes, CU_MEMHOSTALLOC_DEVICEMAP),
                      "cuMemHostAlloc"));
    buffers_.push_back({host, bytes});
    std::memset(host, 0, bytes);
    CUdeviceptr device = 0;
    XAUTO_TRY(
        cuda::checked(cuMemHostGetDevicePointer(&device, host, 0), "cuMemHostGetDevicePointer"));
    if (!execution_->setTensorAddress(spec.name.c_str(), reinterpret_cast<void*>(device)))
      return tl::unexpected<Error>(refused({}));
    return {};
  }

  Model model_;
  detail::Logger logger_;
  std::unique_ptr<cuda::Context> cuda_;
  std::unique_ptr<nvinfer1::IRuntime> runtime_;
  std::unique_ptr<nvinfer1::ICudaEngine> engine_;
  std::unique_ptr<nvinfer1::IExecutionContext> execution_;
  std::vector<TensorSpec> inputs_, outputs_;
  std::vector<Buffer> buffers_;  ///< inputs, outputs, outputs that nobody asked for
};

/// The `init` of an XNode that runs a plan on a GPU; its exec gets the Session, as with onnx::load(). The
/// XPU instance's index is the GPU's.
[[nodiscard]] inline auto load(Model model) {
  return cuda::detail::loader<Session>(std::move(model));
}

}  // namespace xauto::tensorrt

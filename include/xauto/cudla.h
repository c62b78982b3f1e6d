// SPDX-License-Identifier: Apache-2.0
// An XNode from a DLA loadable, by cuDLA in its hybrid mode. Only for apps that have cuDLA (cudla.h,
// libcudla) and CUDA (cuda.h, libcuda). Compiled and tested against declarations written from NVIDIA's
// documentation; not run on hardware yet.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <cudla.h>

#include <xauto/cuda.h>
#include <xauto/result.h>
#include <xauto/tensor.h>
#include <xauto/xpu.h>

/// XNodes from DLA loadables: cudla.h.
namespace xauto::dla {

/// Which loadable, and what the app counts on.
struct Model {
  std::string file;  ///< path of the loadable, as `trtexec --buildDLAStandalone` writes it
  /// As onnx::Model::inputs; shapes are {n, c, h, w}. Empty: all of the loadable's.
  std::vector<TensorSpec> inputs = {};
  std::vector<TensorSpec> outputs = {};  ///< likewise, all of them
};

namespace detail {

inline Status checked(cudlaStatus status, const char* call, const std::string& where) {
  if (status == cudlaSuccess) return {};
  return fail(status == cudlaErrorInvalidModule || status == cudlaErrorInvalidParam
                  ? ErrorCode::kInvalid
                  : ErrorCode::kUnavailable,
              std::string(call) + ": cuDLA error " + std::to_string(static_cast<int>(status)),
              where);
}

inline Result<ElementType> element_type(const cudlaModuleTensorDescriptor& tensor,
                                        const std::string& where) {
  switch (tensor.dataType) {
    case CUDLA_DATA_TYPE_FLOAT:
      return ElementType::kFloat32;
    case CUDLA_DATA_TYPE_HALF:
      return ElementType::kFloat16;
    case CUDLA_DATA_TYPE_INT16:
      return ElementType::kInt16;
    case CUDLA_DATA_TYPE_INT8:
      return ElementType::kInt8;
    case CUDLA_DATA_TYPE_UINT8:
      return ElementType::kUint8;
    case CUDLA_DATA_TYPE_UINT16:
      return ElementType::kUint16;
    default:
      return fail(ErrorCode::kInvalid,
                  std::string("\"") + tensor.name + "\" has elements of cuDLA's type " +
                      std::to_string(tensor.dataType),
                  where);
  }
}

}  // namespace detail

/// A loadable with its buffers, on a cuDLA device of its own. Threads: one at a time.
class Session {
 public:
  /// Loads it on DLA `index`, compares it with what the app counts on, makes the buffers, and runs once on
  /// zeros. Errors: kNotFound: no such file; kInvalid: no loadable, or other tensors; kUnavailable: CUDA's or
  /// cuDLA's own.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(Model model, int index = 0) {
    std::unique_ptr<Session> made(new Session(std::move(model)));
    XAUTO_ASSIGN(made->cuda_, cuda::Context::create(0));  // the GPU that the DLAs belong to
    const cuda::Context::Scope scope(*made->cuda_);
    XAUTO_TRY(scope.entered());
    XAUTO_TRY(made->load(index));
    XAUTO_TRY(made->bind());
    XAUTO_TRY(made->run());
    return made;
  }
  /// On the instance's DLA.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(Model model, const XpuId& xpu) {
    return open(std::move(model), xpu.index);
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
  ~Session() {
    if (cuda_ == nullptr) return;
    const cuda::Context::Scope scope(*cuda_);
    for (const Buffer& buffer : buffers_) {
      if (buffer.registered != nullptr) cudlaMemUnregister(device_, buffer.registered);
      if (buffer.memory != 0) cuMemFree(buffer.memory);
      if (buffer.host != nullptr) cuMemFreeHost(buffer.host);
    }
    if (module_ != nullptr) cudlaModuleUnload(module_, 0);
    if (device_ != nullptr) cudlaDestroyDevice(device_);
  }

  /// As agreed between app and loadable.
  [[nodiscard]] std::span<const TensorSpec> inputs() const { return inputs_; }
  /// As agreed.
  [[nodiscard]] std::span<const TensorSpec> outputs() const { return outputs_; }
  /// How an input lies in memory: DLAs pad and interleave channels. input() has all `size` bytes of it.
  [[nodiscard]] const cudlaModuleTensorDescriptor& input_layout(std::size_t index) const {
    return buffers_.at(index).layout;
  }
  /// The same of an output.
  [[nodiscard]] const cudlaModuleTensorDescriptor& output_layout(std::size_t index) const {
    return buffers_.at(inputs_.size() + index).layout;
  }
  /// As onnx::Session::input(), padding included.
  template <class T>
  [[nodiscard]] std::span<T> input(std::size_t index) {
    (void)xauto::detail::tensor_at<T>(inputs_, index, "input");
    return {static_cast<T*>(buffers_[index].host), buffers_[index].layout.size / sizeof(T)};
  }
  /// As onnx::Session::output(), padding included.
  template <class T>
  [[nodiscard]] std::span<const T> output(std::size_t index) const {
    (void)xauto::detail::tensor_at<T>(outputs_, index, "output");
    const Buffer& buffer = buffers_[inputs_.size() + index];
    return {static_cast<const T*>(buffer.host), buffer.layout.size / sizeof(T)};
  }

  /// Computes all outputs from the inputs, and waits for the DLA. Error: kUnavailable.
  [[nodiscard]] Status run() {
    const cuda::Context::Scope scope(*cuda_);
    XAUTO_TRY(scope.entered());
    for (std::size_t i = 0; i < inputs_.size(); ++i)
      XAUTO_TRY(cuda::checked(cuMemcpyHtoDAsync(buffers_[i].memory, buffers_[i].host,
                                                buffers_[i].layout.size, cuda_->stream()),
                              "cuMemcpyHtoDAsync"));
    cudlaTask task{};
    task.moduleHandle = module_;
    task.inputTensor = raw_inputs_.data();
    task.numInputTensors = static_cast<std::uint32_t>(raw_inputs_.size());
    task.outputTensor = raw_outputs_.data();
    task.numOutputTensors = static_cast<std::uint32_t>(raw_outputs_.size());
    XAUTO_TRY(checked(cudlaSubmitTask(device_, &task, 1, cuda_->stream(), 0), "cudlaSubmitTask"));
    for (std::size_t i = inputs_.size(); i < buffers_.size(); ++i)
      XAUTO_TRY(cuda::checked(cuMemcpyDtoHAsync(buffers_[i].host, buffers_[i].memory,
                                                buffers_[i].layout.size, cuda_->stream()),
                              "cuMemcpyDtoHAsync"));
    const Status done = cuda_->synchronize();
    // A fault of the DLA comes out of CUDA as a foreign device's; cuDLA knows which.
    XAUTO_TRY(checked(cudlaGetLastError(device_), "the DLA"));
    return done;
  }

  /// Behind which all of its work is queued.
  [[nodiscard]] SchedHandle handle() const { return SchedHandle::cudla_device(device_); }

 private:
  struct Buffer {
    cudlaModuleTensorDescriptor layout{};
    void* host = nullptr;
    CUdeviceptr memory = 0;
    std::uint64_t* registered = nullptr;
  };
  explicit Session(Model model) : model_(std::move(model)) {}

  [[nodiscard]] Status checked(cudlaStatus status, const char* call) const {
    return detail::checked(status, call, model_.file);
  }

  [[nodiscard]] Status load(int index) {
    XAUTO_ASSIGN(const std::vector<char> loadable, xauto::detail::whole_file(model_.file));
    XAUTO_TRY(
        checked(cudlaCreateDevice(static_cast<std::uint64_t>(index), &device_, CUDLA_CUDA_DLA),
                "cudlaCreateDevice"));
    return checked(
        cudlaModuleLoadFromMemory(device_, reinterpret_cast<const std::uint8_t*>(loadable.data()),
                                  loadable.size(), &module_, 0),
        "cudlaModuleLoadFromMemory");
  }

  /// All inputs or outputs that the loadable has.
  [[nodiscard]] Result<std::vector<cudlaModuleTensorDescriptor>> in_model(bool inputs) const {
    cudlaModuleAttribute attribute{};
    XAUTO_TRY(checked(
        cudlaModuleGetAttributes(
            module_, inputs ? CUDLA_NUM_INPUT_TENSORS : CUDLA_NUM_OUTPUT_TENSORS, &attribute),
        "cudlaModuleGetAttributes"));
    const std::uint32_t count = inputs ? attribute.numInputTensors : attribute.numOutputTensors;
    if (count > 1024)
      return fail(ErrorCode::kInvalid, "has " + std::to_string(count) + " tensors", model_.file);
    std::vector<cudlaModuleTensorDescriptor> tensors(count);
    (inputs ? attribute.inputTensorDesc : attribute.outputTensorDesc) = tensors.data();
    XAUTO_TRY(checked(
        cudlaModuleGetAttributes(
            module_, inputs ? CUDLA_INPUT_TENSOR_DESCRIPTORS : CUDLA_OUTPUT_TENSOR_DESCRIPTORS,
            &attribute),
        "cudlaModuleGetAttributes"));
    return tensors;
  }

  /// A task names its tensors in the loadable's order, so the app's order is that one.
  [[nodiscard]] Result<std::vector<TensorSpec>> agree(
      const std::vector<TensorSpec>& asked, const std::vector<cudlaModuleTensorDescriptor>& tensors,
      const char* kind) const {
    std::vector<TensorSpec> has;
    for (const cudlaModuleTensorDescriptor& tensor : tensors) {
      XAUTO_ASSIGN(const ElementType type, detail::element_type(tensor, model_.file));
      std::vector<std::int64_t> shape;
      for (const std::uint64_t dimension : {tensor.n, tensor.c, tensor.h, tensor.w}) {
        if (dimension > xauto::detail::kMaxTensorBytes)
          return fail(ErrorCode::kInvalid, std::string("\"") + tensor.name + "\" is too large",
                      model_.file);
        shape.push_back(static_cast<std::int64_t>(dimension));
      }
      has.push_back({tensor.name, type, std::move(shape)});
      XAUTO_ASSIGN(const std::size_t least, xauto::detail::bytes_of(has.back(), model_.file));
      if (tensor.size < least || tensor.size > xauto::detail::kMaxTensorBytes)
        return fail(ErrorCode::kInvalid,
                    std::string("\"") + tensor.name + "\" (" + xauto::detail::text_of(has.back()) +
                        ") takes " + std::to_string(tensor.size) + " bytes",
                    model_.file);
    }
    XAUTO_ASSIGN(std::vector<TensorSpec> made,
                 xauto::detail::agreed(asked, has, kind, model_.file));
    for (std::size_t i = 0; i < has.size(); ++i)
      if (made.size() != has.size() || made[i].name != has[i].name)
        return fail(ErrorCode::kInvalid,
                    std::string("the app does not name all ") + kind + "s in the loadable's order",
                    model_.file,
                    std::string(kind) + " " + std::to_string(i) + " is \"" + has[i].name + "\"");
    return made;
  }

  [[nodiscard]] Status bind() {
    XAUTO_ASSIGN(const std::vector<cudlaModuleTensorDescriptor> in, in_model(true));
    XAUTO_ASSIGN(const std::vector<cudlaModuleTensorDescriptor> out, in_model(false));
    XAUTO_ASSIGN(inputs_, agree(model_.inputs, in, "input"));
    XAUTO_ASSIGN(outputs_, agree(model_.outputs, out, "output"));
    for (const cudlaModuleTensorDescriptor& tensor : in) {
      XAUTO_TRY(add_buffer(tensor));
      raw_inputs_.push_back(buffers_.back().registered);
    }
    for (const cudlaModuleTensorDescriptor& tensor : out) {
      XAUTO_TRY(add_buffer(tensor));
      raw_outputs_.push_back(buffers_.back().registered);
    }
    return {};
  }

  [[nodiscard]] Status add_buffer(const cudlaModuleTensorDescriptor& tensor) {
    Buffer& buffer = buffers_.emplace_back();  // the destructor frees what there is
    buffer.layout = tensor;
    const auto bytes = static_cast<std::size_t>(tensor.size);
    XAUTO_TRY(cuda::checked(cuMemHostAlloc(&buffer.host, bytes, 0), "cuMemHostAlloc"));
    std::fill_n(static_cast<std::byte*>(buffer.host), bytes, std::byte{0});
    XAUTO_TRY(cuda::checked(cuMemAlloc(&buffer.memory, bytes), "cuMemAlloc"));
    return checked(cudlaMemRegister(device_, reinterpret_cast<const std::uint64_t*>(buffer.memory),
                                    bytes, &buffer.registered, 0),
                   "cudlaMemRegister");
  }

  Model model_;
  std::unique_ptr<cuda::Context> cuda_;
  cudlaDevHandle device_ = nullptr;
  cudlaModule module_ = nullptr;
  std::vector<TensorSpec> inputs_, outputs_;
  std::vector<Buffer> buffers_;  ///< inputs, then outputs
  std::vector<const std::uint64_t*> raw_inputs_;
  std::vector<std::uint64_t*> raw_outputs_;
};

/// The `init` of an XNode that runs a loadable on a DLA; its exec gets the Session, as with onnx::load(). The
/// XPU instance's index is the DLA's.
[[nodiscard]] inline auto load(Model model) {
  return cuda::detail::loader<Session>(std::move(model));
}

}  // namespace xauto::dla

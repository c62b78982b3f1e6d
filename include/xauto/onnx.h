// SPDX-License-Identifier: Apache-2.0
// An XNode from an ONNX file, by ONNX Runtime's C API. Only for apps that have ONNX Runtime: its header
// (onnxruntime_c_api.h) has to be found, and libonnxruntime is the app's to link.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <new>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <onnxruntime_c_api.h>

#include <xauto/result.h>
#include <xauto/tensor.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>

/// XNodes from ONNX files: onnx.h.
namespace xauto::onnx {

/// Which net, and what the app counts on.
struct Model {
  std::string file;  ///< path of the .onnx file
  /// Names, types and shapes that the app counts on; the order is that of Session::input(). Empty: all
  /// of the model's. A dimension that the model leaves open gets its size here.
  std::vector<TensorSpec> inputs = {};
  std::vector<TensorSpec> outputs = {};  ///< likewise; a dimension may stay kAnyDimension
  /// Threads that compute one operator, 1 to 64. With 1, all work is done on the thread that calls
  /// run(): the XNode's, on the CPU that the policy gives it. More of them run where the scheduler
  /// knows nothing of them; no worst case holds then.
  int threads = 1;
  /// Called before the session is made, to add what it computes with: an execution provider, say.
  /// Null: the CPU. What it returns is an error, as from all of ONNX Runtime's functions, or null.
  std::function<OrtStatus*(const OrtApi&, OrtSessionOptions*)> configure = {};
};

namespace detail {

struct Deleter {
  const OrtApi* api = nullptr;
  void operator()(OrtEnv* object) const { api->ReleaseEnv(object); }
  void operator()(OrtSessionOptions* object) const { api->ReleaseSessionOptions(object); }
  void operator()(OrtSession* object) const { api->ReleaseSession(object); }
  void operator()(OrtMemoryInfo* object) const { api->ReleaseMemoryInfo(object); }
  void operator()(OrtValue* object) const { api->ReleaseValue(object); }
  void operator()(OrtTypeInfo* object) const { api->ReleaseTypeInfo(object); }
  void operator()(OrtTensorTypeAndShapeInfo* object) const {
    api->ReleaseTensorTypeAndShapeInfo(object);
  }
};
template <class T>
using Handle = std::unique_ptr<T, Deleter>;

/// ONNX's element types in the order of ElementType.
inline constexpr ONNXTensorElementDataType kElements[] = {
    ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT,   ONNX_TENSOR_ELEMENT_DATA_TYPE_DOUBLE,
    ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT16, ONNX_TENSOR_ELEMENT_DATA_TYPE_INT8,
    ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT8,   ONNX_TENSOR_ELEMENT_DATA_TYPE_INT16,
    ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT16,  ONNX_TENSOR_ELEMENT_DATA_TYPE_INT32,
    ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT32,  ONNX_TENSOR_ELEMENT_DATA_TYPE_INT64,
    ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT64,  ONNX_TENSOR_ELEMENT_DATA_TYPE_BOOL};

struct FreeAligned {
  static constexpr std::align_val_t kAlignment{64};  ///< a cache line, and the widest vector load
  void operator()(std::byte* bytes) const { ::operator delete[](bytes, kAlignment); }
};

}  // namespace detail

/// A loaded net with its buffers. Threads: one at a time.
class Session {
 public:
  /// Loads the file, compares it with what the app counts on, makes the buffers, and runs once on
  /// zeros. So what the first run allocates is there before the first release.
  ///
  /// Errors: kNotFound: no such file. kInvalid: no model, other tensors, or a run that fails.
  /// kUnavailable: ONNX Runtime is older than the header that this was compiled with, or lacks what
  /// `configure` asks for.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(Model model) {
    const OrtApiBase* base = OrtGetApiBase();
    const OrtApi* api = base->GetApi(ORT_API_VERSION);
    if (api == nullptr)
      return fail(ErrorCode::kUnavailable,
                  std::string("ONNX Runtime ") + base->GetVersionString() + " has no version " +
                      std::to_string(ORT_API_VERSION) + " of its API",
                  model.file,
                  "use ONNX Runtime 1." + std::to_string(ORT_API_VERSION) + " or newer");
    std::unique_ptr<Session> made(new Session(*api, std::move(model)));
    XAUTO_TRY(made->load());
    XAUTO_TRY(made->bind());
    XAUTO_TRY(made->run());
    return made;
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// As agreed between app and model.
  [[nodiscard]] std::span<const TensorSpec> inputs() const { return inputs_; }
  /// As agreed; kAnyDimension where only a run tells.
  [[nodiscard]] std::span<const TensorSpec> outputs() const { return outputs_; }

  /// The elements of an input, to be written before run(). They stay as they are until written again.
  /// Throws std::logic_error if there is no such input or T is not its type.
  template <class T>
  [[nodiscard]] std::span<T> input(std::size_t index) {
    const TensorSpec& spec = xauto::detail::tensor_at<T>(inputs_, index, "input");
    const std::size_t bytes = sizes_[index];
    return {reinterpret_cast<T*>(buffers_[index].get()), bytes / size_of(spec.type)};
  }

  /// The elements of an output of the last run(), valid until the next one. Throws as input() does.
  template <class T>
  [[nodiscard]] std::span<const T> output(std::size_t index) const {
    (void)xauto::detail::tensor_at<T>(outputs_, index, "output");
    return {static_cast<const T*>(results_[index].data), results_[index].elements};
  }

  /// The shape that an output of the last run() has. Throws std::out_of_range (a std::logic_error) if
  /// there is none.
  [[nodiscard]] const std::vector<std::int64_t>& output_shape(std::size_t index) const {
    return results_.at(index).shape;
  }

  /// Computes all outputs from the inputs. Allocates nothing of its own, unless an output has a
  /// dimension that only a run tells. Error: kInvalid, with ONNX Runtime's words.
  [[nodiscard]] Status run() {
    for (std::size_t i = 0; i < outputs_.size(); ++i)
      if (results_[i].from_runtime) {
        results_[i].elements = 0;  // of a run that fails there is nothing
        values_[inputs_.size() + i].reset();
        raw_outputs_[i] = nullptr;
      }
    XAUTO_TRY(checked(api_->Run(session_.get(), nullptr, input_names_.data(), raw_inputs_.data(),
                                raw_inputs_.size(), output_names_.data(), output_names_.size(),
                                raw_outputs_.data())));
    for (std::size_t i = 0; i < outputs_.size(); ++i)
      if (results_[i].from_runtime) {
        values_[inputs_.size() + i].reset(raw_outputs_[i]);
        XAUTO_TRY(look_at(i));
      }
    return {};
  }

 private:
  template <class T>
  using Handle = detail::Handle<T>;
  struct Output {
    bool from_runtime = false;  ///< made by each run: its size is not known before
    const void* data = nullptr;
    std::size_t elements = 0;
    std::vector<std::int64_t> shape;
  };

  Session(const OrtApi& api, Model model) : api_(&api), model_(std::move(model)) {}

  [[nodiscard]] Status checked(OrtStatus* status) const {
    if (status == nullptr) return {};
    const OrtErrorCode code = api_->GetErrorCode(status);
    std::string text = api_->GetErrorMessage(status);
    api_->ReleaseStatus(status);
    return fail(code == ORT_NO_SUCHFILE ? ErrorCode::kNotFound
                : code == ORT_EP_FAIL   ? ErrorCode::kUnavailable
                                        : ErrorCode::kInvalid,
                "ONNX Runtime: " + text, model_.file);
  }
  template <class T>
  [[nodiscard]] Handle<T> owned(T* object) const {
    return Handle<T>(object, detail::Deleter{api_});
  }

  [[nodiscard]] Status load() {
    if (model_.threads < 1 || model_.threads > 64)
      return fail(ErrorCode::kInvalid,
                  "threads is " + std::to_string(model_.threads) + ", not 1 to 64", model_.file);
    OrtEnv* env = nullptr;
    XAUTO_TRY(checked(api_->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "xauto", &env)));
    env_ = owned(env);
    OrtSessionOptions* made = nullptr;
    XAUTO_TRY(checked(api_->CreateSessionOptions(&made)));
    const Handle<OrtSessionOptions> options = owned(made);
    XAUTO_TRY(checked(api_->SetIntraOpNumThreads(made, model_.threads)));
    XAUTO_TRY(checked(api_->SetInterOpNumThreads(made, 1)));
    XAUTO_TRY(checked(api_->SetSessionExecutionMode(made, ORT_SEQUENTIAL)));
    // Threads that wait must not burn a core that another XNode has.
    XAUTO_TRY(checked(api_->AddSessionConfigEntry(made, "session.intra_op.allow_spinning", "0")));
    if (model_.configure) XAUTO_TRY(checked(model_.configure(*api_, made)));
    OrtSession* session = nullptr;
    XAUTO_TRY(checked(api_->CreateSession(env, model_.file.c_str(), made, &session)));
    session_ = owned(session);
    return {};
  }

  /// All inputs or outputs that the model has.
  [[nodiscard]] Result<std::vector<TensorSpec>> in_model(bool inputs) const {
    const OrtSession* session = session_.get();
    std::size_t count = 0;
    XAUTO_TRY(checked(inputs ? api_->SessionGetInputCount(session, &count)
                             : api_->SessionGetOutputCount(session, &count)));
    OrtAllocator* allocator = nullptr;
    XAUTO_TRY(checked(api_->GetAllocatorWithDefaultOptions(&allocator)));
    std::vector<TensorSpec> specs;
    for (std::size_t i = 0; i < count; ++i) {
      char* name = nullptr;
      XAUTO_TRY(checked(inputs ? api_->SessionGetInputName(session, i, allocator, &name)
                               : api_->SessionGetOutputName(session, i, allocator, &name)));
      TensorSpec spec{name};
      XAUTO_TRY(checked(api_->AllocatorFree(allocator, name)));
      OrtTypeInfo* type = nullptr;
      XAUTO_TRY(checked(inputs ? api_->SessionGetInputTypeInfo(session, i, &type)
                               : api_->SessionGetOutputTypeInfo(session, i, &type)));
      const Handle<OrtTypeInfo> owner = owned(type);
      const OrtTensorTypeAndShapeInfo* info = nullptr;  // part of `type`
      XAUTO_TRY(checked(api_->CastTypeInfoToTensorInfo(type, &info)));
      if (info == nullptr)
        return fail(ErrorCode::kInvalid, "\"" + spec.name + "\" is no tensor", model_.file,
                    "export the model without sequences, maps and optional values");
      XAUTO_ASSIGN(spec, described(std::move(spec.name), info));
      specs.push_back(std::move(spec));
    }
    return specs;
  }

  [[nodiscard]] Result<TensorSpec> described(std::string name,
                                             const OrtTensorTypeAndShapeInfo* info) const {
    ONNXTensorElementDataType type = ONNX_TENSOR_ELEMENT_DATA_TYPE_UNDEFINED;
    XAUTO_TRY(checked(api_->GetTensorElementType(info, &type)));
    const auto* found = std::find(std::begin(detail::kElements), std::end(detail::kElements), type);
    if (found == std::end(detail::kElements))
      return fail(ErrorCode::kInvalid,
                  "\"" + name + "\" has elements of ONNX's type " + std::to_string(type),
                  model_.file, "export the model with numbers of 8 to 64 bits");
    std::size_t rank = 0;
    XAUTO_TRY(checked(api_->GetDimensionsCount(info, &rank)));
    std::vector<std::int64_t> shape(rank);
    XAUTO_TRY(checked(api_->GetDimensions(info, shape.data(), rank)));
    return TensorSpec{std::move(name),
                      static_cast<ElementType>(found - std::begin(detail::kElements)),
                      std::move(shape)};
  }

  [[nodiscard]] Status bind() {
    XAUTO_ASSIGN(const std::vector<TensorSpec> model_inputs, in_model(true));
    XAUTO_ASSIGN(inputs_, xauto::detail::agreed(model_.inputs, model_inputs, "input", model_.file));
    XAUTO_ASSIGN(const std::vector<TensorSpec> model_outputs, in_model(false));
    XAUTO_ASSIGN(outputs_,
                 xauto::detail::agreed(model_.outputs, model_outputs, "output", model_.file));
    OrtMemoryInfo* memory = nullptr;
    XAUTO_TRY(checked(api_->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &memory)));
    memory_ = owned(memory);
    results_.resize(outputs_.size());
    for (const TensorSpec& spec : inputs_) {
      if (!xauto::detail::is_known(spec.shape))
        return fail(ErrorCode::kInvalid,
                    "the model leaves the size of input \"" + spec.name + "\" open (" +
                        xauto::detail::text_of(spec) + ")",
                    model_.file, "state it in Model::inputs");
      XAUTO_TRY(add_buffer(spec));
      input_names_.push_back(spec.name.c_str());
      raw_inputs_.push_back(values_.back().get());
    }
    for (std::size_t i = 0; i < outputs_.size(); ++i) {
      const TensorSpec& spec = outputs_[i];
      results_[i].from_runtime = !xauto::detail::is_known(spec.shape);
      if (results_[i].from_runtime) {
        values_.push_back(owned<OrtValue>(nullptr));
      } else {
        XAUTO_TRY(add_buffer(spec));
        results_[i].data = buffers_.back().get();
        results_[i].elements = sizes_.back() / size_of(spec.type);
        results_[i].shape = spec.shape;
      }
      output_names_.push_back(spec.name.c_str());
      raw_outputs_.push_back(values_.back().get());
    }
    return {};
  }

  /// A buffer of zeros, and the value that refers to it.
  [[nodiscard]] Status add_buffer(const TensorSpec& spec) {
    XAUTO_ASSIGN(const std::size_t bytes, xauto::detail::bytes_of(spec, model_.file));
    auto* memory = static_cast<std::byte*>(
        ::operator new[](std::max<std::size_t>(bytes, 1), detail::FreeAligned::kAlignment));
    std::fill_n(memory, bytes, std::byte{0});
    buffers_.emplace_back(memory);
    sizes_.push_back(bytes);
    OrtValue* value = nullptr;
    XAUTO_TRY(checked(api_->CreateTensorWithDataAsOrtValue(
        memory_.get(), memory, bytes, spec.shape.data(), spec.shape.size(),
        detail::kElements[static_cast<std::size_t>(spec.type)], &value)));
    values_.push_back(owned(value));
    return {};
  }

  /// What the runtime made of an output.
  [[nodiscard]] Status look_at(std::size_t index) {
    OrtValue* value = raw_outputs_[index];
    OrtTensorTypeAndShapeInfo* info = nullptr;
    XAUTO_TRY(checked(api_->GetTensorTypeAndShape(value, &info)));
    const Handle<OrtTensorTypeAndShapeInfo> owner = owned(info);
    XAUTO_ASSIGN(TensorSpec spec, described(outputs_[index].name, info));
    XAUTO_TRY(xauto::detail::agreed(outputs_[index], spec, model_.file));
    XAUTO_ASSIGN(const std::size_t bytes, xauto::detail::bytes_of(spec, model_.file));
    void* data = nullptr;
    XAUTO_TRY(checked(api_->GetTensorMutableData(value, &data)));
    results_[index].data = data;
    results_[index].elements = bytes / size_of(spec.type);
    results_[index].shape = std::move(spec.shape);
    return {};
  }

  const OrtApi* api_;
  Model model_;
  Handle<OrtEnv> env_;  ///< of the process, counted; outlives the session
  Handle<OrtSession> session_;
  Handle<OrtMemoryInfo> memory_;
  std::vector<TensorSpec> inputs_, outputs_;
  std::vector<std::unique_ptr<std::byte[], detail::FreeAligned>> buffers_;  ///< inputs first
  std::vector<std::size_t> sizes_;                                          ///< of buffers_
  std::vector<Handle<OrtValue>> values_;  ///< inputs, then outputs; refer to buffers_
  std::vector<const char*> input_names_, output_names_;
  std::vector<const OrtValue*> raw_inputs_;
  std::vector<OrtValue*> raw_outputs_;
  std::vector<Output> results_;
};

/// The `init` of an XNode that runs a net; its exec gets the Session:
///
///   faces.add_impl(XPU::CPU, xauto::onnx::load({.file = "face.onnx"}),
///                  [](xauto::onnx::Session& net, State& state, const xauto::Input& in) -> xauto::Status {
///                    prepare(in.get(images), net.input<float>(0));
///                    XAUTO_TRY(net.run());
///                    state.faces = decode(net.output<float>(0));
///                    return {};
///                  });
///
/// `handle`: behind which the work is queued, if `Model::configure` has it computed elsewhere than on
/// this thread. What open() says becomes the message of the exception that ends the run.
[[nodiscard]] inline auto load(Model model, std::function<SchedHandle(const XpuId&)> handle = {}) {
  return [model = std::move(model), handle = std::move(handle)](const XpuId& xpu) {
    Result<std::unique_ptr<Session>> session = Session::open(model);
    if (!session) throw std::runtime_error(session.error().to_string());
    return own(std::move(session).value(), handle ? handle(xpu) : SchedHandle::thread());
  };
}

}  // namespace xauto::onnx

// SPDX-License-Identifier: Apache-2.0
// xauto-onnxcheck WHOLE PART...: whether the parts of a net, one after the other, compute what the whole does, by ONNX
// Runtime, bit by bit, from random inputs. A program of its own: `xauto split` needs no ONNX Runtime, and a model that
// makes it fail costs a child. Without its optimizations, which join operators that a cut takes apart.
//
// Exit status: 0 equal, 1 not, 2 the whole does not run here. What it says goes to stderr.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iostream>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <xauto/onnx.h>

namespace {

using namespace xauto;

constexpr std::size_t kMostElements = 1u << 28;

class Runtime {
 public:
  static Result<std::unique_ptr<Runtime>> make() {
    const OrtApi* api = OrtGetApiBase()->GetApi(ORT_API_VERSION);
    if (api == nullptr)
      return fail(ErrorCode::kUnavailable, "ONNX Runtime is older than its header", "", "");
    std::unique_ptr<Runtime> made(new Runtime(*api));
    OrtEnv* env = nullptr;
    XAUTO_TRY(made->checked(api->CreateEnv(ORT_LOGGING_LEVEL_FATAL, "xauto-onnxcheck", &env)));
    made->env_ = made->owned(env);
    OrtMemoryInfo* memory = nullptr;
    XAUTO_TRY(
        made->checked(api->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &memory)));
    made->memory_ = made->owned(memory);
    return made;
  }

  using Values = std::map<std::string, onnx::detail::Handle<OrtValue>>;

  /// Runs a model on values by name, and adds its outputs to them. What is missing is filled at random.
  Status run(const std::string& file, Values& values, std::vector<std::string>* outputs) {
    OrtSessionOptions* made = nullptr;
    XAUTO_TRY(checked(api_.CreateSessionOptions(&made)));
    const auto options = owned(made);
    XAUTO_TRY(checked(api_.SetIntraOpNumThreads(made, 1)));
    XAUTO_TRY(checked(api_.SetSessionGraphOptimizationLevel(made, ORT_DISABLE_ALL)));
    OrtSession* opened = nullptr;
    XAUTO_TRY(checked(api_.CreateSession(env_.get(), file.c_str(), made, &opened)));
    const auto session = owned(opened);
    std::vector<std::string> in, out;
    XAUTO_TRY(names(opened, true, in));
    XAUTO_TRY(names(opened, false, out));
    std::vector<const char*> in_names, out_names;
    std::vector<const OrtValue*> given;
    for (std::size_t i = 0; i < in.size(); ++i) {
      if (!values.contains(in[i])) XAUTO_TRY(fill(opened, i, in[i], values));
      in_names.push_back(in[i].c_str());
      given.push_back(values.at(in[i]).get());
    }
    for (const std::string& name : out) out_names.push_back(name.c_str());
    std::vector<OrtValue*> got(out.size(), nullptr);
    XAUTO_TRY(checked(api_.Run(opened, nullptr, in_names.data(), given.data(), given.size(),
                               out_names.data(), out_names.size(), got.data())));
    for (std::size_t o = 0; o < out.size(); ++o) values.insert_or_assign(out[o], owned(got[o]));
    if (outputs != nullptr) *outputs = out;
    return {};
  }

  /// Errors: they differ, or one is no tensor of numbers.
  Status compare(const std::string& name, OrtValue* one, OrtValue* other) {
    std::vector<std::int64_t> shapes[2];
    std::string bytes[2];
    for (int i = 0; i < 2; ++i) {
      OrtValue* value = i == 0 ? one : other;
      OrtTensorTypeAndShapeInfo* made = nullptr;
      XAUTO_TRY(checked(api_.GetTensorTypeAndShape(value, &made)));
      const auto info = owned(made);
      std::size_t rank = 0, count = 0, size = 0;
      XAUTO_TRY(checked(api_.GetDimensionsCount(made, &rank)));
      shapes[i].resize(rank);
      XAUTO_TRY(checked(api_.GetDimensions(made, shapes[i].data(), rank)));
      XAUTO_TRY(checked(api_.GetTensorShapeElementCount(made, &count)));
      XAUTO_ASSIGN(size, element_size(made, name));
      void* data = nullptr;
      XAUTO_TRY(checked(api_.GetTensorMutableData(value, &data)));
      bytes[i].assign(static_cast<const char*>(data), count * size);
    }
    if (shapes[0] != shapes[1] || bytes[0] != bytes[1])
      return fail(ErrorCode::kInfeasible, "output '" + name + "' differs from the whole net's");
    return {};
  }

 private:
  explicit Runtime(const OrtApi& api) : api_(api) {}

  template <class T>
  onnx::detail::Handle<T> owned(T* object) const {
    return onnx::detail::Handle<T>(object, onnx::detail::Deleter{&api_});
  }

  Status checked(OrtStatus* status) const {
    if (status == nullptr) return {};
    const std::string text = api_.GetErrorMessage(status);
    api_.ReleaseStatus(status);
    return fail(ErrorCode::kInvalid, "ONNX Runtime: " + text);
  }

  Status names(const OrtSession* session, bool inputs, std::vector<std::string>& into) {
    std::size_t count = 0;
    XAUTO_TRY(checked(inputs ? api_.SessionGetInputCount(session, &count)
                             : api_.SessionGetOutputCount(session, &count)));
    OrtAllocator* allocator = nullptr;
    XAUTO_TRY(checked(api_.GetAllocatorWithDefaultOptions(&allocator)));
    for (std::size_t i = 0; i < count; ++i) {
      char* name = nullptr;
      XAUTO_TRY(checked(inputs ? api_.SessionGetInputName(session, i, allocator, &name)
                               : api_.SessionGetOutputName(session, i, allocator, &name)));
      into.emplace_back(name);
      XAUTO_TRY(checked(api_.AllocatorFree(allocator, name)));
    }
    return {};
  }

  Result<std::size_t> element_size(const OrtTensorTypeAndShapeInfo* info, const std::string& name) {
    ONNXTensorElementDataType type = ONNX_TENSOR_ELEMENT_DATA_TYPE_UNDEFINED;
    XAUTO_TRY(checked(api_.GetTensorElementType(info, &type)));
    const auto* found =
        std::find(std::begin(onnx::detail::kElements), std::end(onnx::detail::kElements), type);
    if (found == std::end(onnx::detail::kElements))
      return fail(ErrorCode::kInvalid, "'" + name + "' has no elements that are numbers");
    return size_of(static_cast<ElementType>(found - std::begin(onnx::detail::kElements)));
  }

  /// Dimensions that are left open are 1. Floats from -1 to 1, whole numbers 0 or 1, so that they may be indices.
  Status fill(const OrtSession* session, std::size_t index, const std::string& name,
              Values& values) {
    OrtTypeInfo* made = nullptr;
    XAUTO_TRY(checked(api_.SessionGetInputTypeInfo(session, index, &made)));
    const auto type_info = owned(made);
    const OrtTensorTypeAndShapeInfo* info = nullptr;
    XAUTO_TRY(checked(api_.CastTypeInfoToTensorInfo(made, &info)));
    if (info == nullptr) return fail(ErrorCode::kInvalid, "input '" + name + "' is no tensor");
    XAUTO_ASSIGN(const std::size_t size, element_size(info, name));
    ONNXTensorElementDataType type = ONNX_TENSOR_ELEMENT_DATA_TYPE_UNDEFINED;
    XAUTO_TRY(checked(api_.GetTensorElementType(info, &type)));
    std::size_t rank = 0, count = 1;
    XAUTO_TRY(checked(api_.GetDimensionsCount(info, &rank)));
    std::vector<std::int64_t> shape(rank);
    XAUTO_TRY(checked(api_.GetDimensions(info, shape.data(), rank)));
    for (std::int64_t& dim : shape) {
      dim = dim < 0 ? 1 : dim;
      count *= static_cast<std::size_t>(dim);
      if (count > kMostElements)
        return fail(ErrorCode::kInvalid, "input '" + name + "' is too large");
    }
    auto& bytes = buffers_.emplace_back(std::make_unique<std::vector<char>>(count * size + 1));
    std::mt19937 random(static_cast<unsigned>(std::hash<std::string>{}(name)));
    for (std::size_t n = 0; n < count; ++n) {
      char* const at = bytes->data() + n * size;
      const double value = static_cast<double>(random()) / 2147483648.0 - 1;
      const float single = static_cast<float>(value);
      const std::uint16_t half = static_cast<std::uint16_t>(random() & 0xBBFFu);  // below 1
      if (type == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
        std::memcpy(at, &single, sizeof single);
      else if (type == ONNX_TENSOR_ELEMENT_DATA_TYPE_DOUBLE)
        std::memcpy(at, &value, sizeof value);
      else if (type == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT16)
        std::memcpy(at, &half, sizeof half);
      else
        *at = static_cast<char>(random() & 1u);
    }
    OrtValue* value = nullptr;
    XAUTO_TRY(checked(api_.CreateTensorWithDataAsOrtValue(
        memory_.get(), bytes->data(), count * size, shape.data(), rank, type, &value)));
    values.insert_or_assign(name, owned(value));
    return {};
  }

  const OrtApi& api_;
  onnx::detail::Handle<OrtEnv> env_;
  onnx::detail::Handle<OrtMemoryInfo> memory_;
  std::vector<std::unique_ptr<std::vector<char>>> buffers_;  ///< of what was filled
};

int say(const Error& error, const std::string& file, int status) {
  std::cerr << file << ": " << error.what << "\n";
  return status;
}

int check(const std::vector<std::string>& files) {
  auto runtime = Runtime::make();
  if (!runtime) return say(runtime.error(), files[0], 2);
  Runtime::Values whole, chain;
  std::vector<std::string> outputs;
  if (const Status ran = (*runtime)->run(files[0], whole, &outputs); !ran)
    return say(ran.error(), files[0], 2);
  for (std::size_t f = 1; f < files.size(); ++f)
    if (const Status ran = (*runtime)->run(files[f], chain, nullptr); !ran)
      return say(ran.error(), files[f], 1);
  for (const std::string& name : outputs) {
    if (!chain.contains(name)) {
      std::cerr << "no part makes output '" << name << "'\n";
      return 1;
    }
    if (const Status same = (*runtime)->compare(name, whole.at(name).get(), chain.at(name).get());
        !same)
      return say(same.error(), files[0], same.error().code == ErrorCode::kInfeasible ? 1 : 2);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::cerr << "usage: xauto-onnxcheck WHOLE PART...\n";
    return 2;
  }
  return check({argv + 1, argv + argc});
}

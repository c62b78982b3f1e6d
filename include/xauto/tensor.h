// SPDX-License-Identifier: Apache-2.0
// What a net takes and gives: names, element types, shapes. onnx.h and tensorrt.h compare it with the model.
#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <xauto/result.h>

namespace xauto {

/// The type of a tensor's elements. Strings and complex numbers are none of them.
enum class ElementType : std::uint8_t {
  kFloat32,
  kFloat64,
  kFloat16,
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kBool,
};

/// A 16-bit float of IEEE 754, as its bits: C++20 has no type for it.
struct Half {
  std::uint16_t bits = 0;  ///< sign, five bits of exponent, ten of fraction
};

namespace detail {
template <class T>
constexpr bool kNoElement = false;
}  // namespace detail

/// The ElementType of a C++ type; types that have none do not compile.
template <class T>
[[nodiscard]] constexpr ElementType element_type() {
  if constexpr (std::is_same_v<T, float>)
    return ElementType::kFloat32;
  else if constexpr (std::is_same_v<T, double>)
    return ElementType::kFloat64;
  else if constexpr (std::is_same_v<T, Half>)
    return ElementType::kFloat16;
  else if constexpr (std::is_same_v<T, bool>)
    return ElementType::kBool;
  else if constexpr (std::is_integral_v<T> && sizeof(T) == 1)
    return std::is_signed_v<T> ? ElementType::kInt8 : ElementType::kUint8;
  else if constexpr (std::is_integral_v<T> && sizeof(T) == 2)
    return std::is_signed_v<T> ? ElementType::kInt16 : ElementType::kUint16;
  else if constexpr (std::is_integral_v<T> && sizeof(T) == 4)
    return std::is_signed_v<T> ? ElementType::kInt32 : ElementType::kUint32;
  else if constexpr (std::is_integral_v<T> && sizeof(T) == 8)
    return std::is_signed_v<T> ? ElementType::kInt64 : ElementType::kUint64;
  else
    static_assert(detail::kNoElement<T>, "T is no element of a tensor");
}

/// "float32"
[[nodiscard]] inline const char* name_of(ElementType type) {
  static constexpr const char* kNames[] = {"float32", "float64", "float16", "int8",
                                           "uint8",   "int16",   "uint16",  "int32",
                                           "uint32",  "int64",   "uint64",  "bool"};
  return kNames[static_cast<std::size_t>(type)];
}

/// Bytes of one element.
[[nodiscard]] constexpr std::size_t size_of(ElementType type) {
  constexpr std::size_t kSizes[] = {4, 8, 2, 1, 1, 2, 2, 4, 4, 8, 8, 1};
  return kSizes[static_cast<std::size_t>(type)];
}

/// A dimension that is not known before a run.
inline constexpr std::int64_t kAnyDimension = -1;

/// An input or output of a net, as an app counts on it or as a model has it.
struct TensorSpec {
  std::string name;                                    ///< as in the model
  ElementType type = ElementType::kFloat32;            ///< of its elements
  std::vector<std::int64_t> shape = {};                ///< outermost dimension first
  bool operator==(const TensorSpec&) const = default;  ///< same name, type and shape
};

/// `tensor<float>("image", {1, 128, 128, 3})`
template <class T>
[[nodiscard]] TensorSpec tensor(std::string name, std::vector<std::int64_t> shape) {
  return {std::move(name), element_type<T>(), std::move(shape)};
}

namespace detail {

/// The most that one tensor may take: a damaged model is to be refused, not allocated.
inline constexpr std::size_t kMaxTensorBytes = std::size_t{1} << 31;

/// "float32 1x128x128x3", an unknown dimension as "?"
inline std::string text_of(const TensorSpec& spec) {
  std::string text = std::string(name_of(spec.type)) + " ";
  for (std::size_t i = 0; i < spec.shape.size(); ++i)
    text += (i == 0 ? "" : "x") + (spec.shape[i] < 0 ? "?" : std::to_string(spec.shape[i]));
  return spec.shape.empty() ? text + "scalar" : text;
}

inline bool is_known(const std::vector<std::int64_t>& shape) {
  for (const std::int64_t dimension : shape)
    if (dimension < 0) return false;
  return true;
}

/// Of a shape that is_known().
inline Result<std::size_t> bytes_of(const TensorSpec& spec, const std::string& where) {
  std::size_t bytes = size_of(spec.type);
  for (const std::int64_t dimension : spec.shape) {
    const auto factor = static_cast<std::size_t>(dimension);
    if (factor != 0 && bytes > kMaxTensorBytes / factor)
      return fail(ErrorCode::kInvalid,
                  "\"" + spec.name + "\" (" + text_of(spec) + ") takes more than 2 GiB", where);
    bytes *= factor;
  }
  return bytes;
}

/// `asked` with the dimensions that the model knows and the app left open.
inline Result<TensorSpec> agreed(const TensorSpec& asked, const TensorSpec& has,
                                 const std::string& where) {
  bool same = asked.type == has.type && asked.shape.size() == has.shape.size();
  TensorSpec both = asked;
  for (std::size_t i = 0; same && i < has.shape.size(); ++i) {
    same = asked.shape[i] == has.shape[i] || asked.shape[i] == kAnyDimension ||
           (has.shape[i] < 0 && asked.shape[i] > 0);
    if (asked.shape[i] == kAnyDimension) both.shape[i] = has.shape[i] < 0 ? -1 : has.shape[i];
  }
  if (!same)
    return fail(ErrorCode::kInvalid,
                "\"" + asked.name + "\" is " + text_of(has) +
                    " in the model, and the app counts on " + text_of(asked),
                where, "correct the app's tensor, or take the model that the app was written for");
  return both;
}

/// What is asked for, in that order, checked against the model; all that the model has if nothing is.
/// `kind`: "input" or "output".
inline Result<std::vector<TensorSpec>> agreed(const std::vector<TensorSpec>& asked,
                                              const std::vector<TensorSpec>& has,
                                              const std::string& kind, const std::string& where) {
  if (asked.empty()) return has;
  std::vector<TensorSpec> made;
  for (const TensorSpec& spec : asked) {
    const TensorSpec* found = nullptr;
    std::string names;
    for (const TensorSpec& candidate : has) {
      if (candidate.name == spec.name) found = &candidate;
      names += (names.empty() ? "\"" : ", \"") + candidate.name + "\" (" + text_of(candidate) + ")";
    }
    if (found == nullptr)
      return fail(ErrorCode::kInvalid, "the model has no " + kind + " \"" + spec.name + "\"", where,
                  "its " + kind + "s are " + names);
    for (const TensorSpec& before : made)
      if (before.name == spec.name)
        return fail(ErrorCode::kInvalid, kind + " \"" + spec.name + "\" is asked for twice", where);
    XAUTO_ASSIGN(TensorSpec both, agreed(spec, *found, where));
    made.push_back(std::move(both));
  }
  if (kind == "input" && made.size() != has.size())
    return fail(ErrorCode::kInvalid,
                "the model has " + std::to_string(has.size()) + " inputs, and the app counts on " +
                    std::to_string(made.size()),
                where, "name all of them");
  return made;
}

/// The whole file, of at most 4 GiB.
inline Result<std::vector<char>> whole_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return fail(ErrorCode::kNotFound, "cannot be opened", path);
  const std::streamoff size = file.tellg();
  if (size <= 0 || size > std::streamoff{1} << 32)
    return fail(ErrorCode::kInvalid, "has " + std::to_string(size) + " bytes, not 1 to 4 GiB",
                path);
  std::vector<char> bytes(static_cast<std::size_t>(size));
  if (!file.seekg(0).read(bytes.data(), size)) return fail(ErrorCode::kIo, "cannot be read", path);
  return bytes;
}

/// The tensor of that number, if T is its type. Throws std::logic_error: the program is wrong.
template <class T>
const TensorSpec& tensor_at(const std::vector<TensorSpec>& specs, std::size_t index,
                            const char* kind) {
  if (index >= specs.size())
    throw std::logic_error(std::string("there is no ") + kind + " " + std::to_string(index) +
                           ": the net has " + std::to_string(specs.size()));
  if (specs[index].type != element_type<T>())
    throw std::logic_error(std::string(kind) + " \"" + specs[index].name + "\" is " +
                           text_of(specs[index]) + ", not " + name_of(element_type<T>()));
  return specs[index];
}

}  // namespace detail
}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// A JSON value, for results that programs read (`--json`, report.json) and for what our daemons
// answer. Objects keep the order in which they were filled.
//
//   Json run = {{"policy", "heft"}, {"p50_us", 31'000}, {"rows", Json::array()}};
//   run["rows"].push_back({{"name", "gpu0"}});
//   std::cout << run.dump(2);
//
// Files of ours have readers that say what is wrong with them: model/json.h. nlohmann stands behind
// both, and is not included here: each file that includes it takes seconds to compile.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

namespace xauto {

class Json {
 public:
  struct NamedValue;

  Json() = default;  ///< null
  template <class T>
  requires std::is_arithmetic_v<T> Json(T value) {
    if constexpr (std::is_same_v<T, bool>)
      set(value);
    else if constexpr (std::is_floating_point_v<T>)
      set(static_cast<double>(value));
    else if constexpr (std::is_signed_v<T>)
      set(static_cast<std::int64_t>(value));
    else
      set(static_cast<std::uint64_t>(value));
  }
  Json(std::string text) : kind_(Kind::kText), text_(std::move(text)) {}
  Json(const char* text) : Json(std::string(text)) {}
  template <class T>
  Json(const std::optional<T>& value) {
    if (value) *this = Json(*value);
  }
  template <class T>
  Json(const std::vector<T>& elements) : kind_(Kind::kArray) {
    for (const T& element : elements) elements_.emplace_back(element);
  }
  Json(std::initializer_list<NamedValue> members);  ///< an object
  [[nodiscard]] static Json array(std::initializer_list<Json> elements = {});
  [[nodiscard]] static Json object();

  /// None: it is not JSON, or nested too deep. Of a key that is there twice the last counts.
  [[nodiscard]] static std::optional<Json> parse(std::string_view text);

  /// The member of this name, added if need be. Null becomes an object.
  Json& operator[](const std::string& key);
  /// Null becomes an array.
  void push_back(Json element);

  [[nodiscard]] bool is_null() const { return kind_ == Kind::kNull; }
  [[nodiscard]] bool is_object() const { return kind_ == Kind::kObject; }
  [[nodiscard]] bool is_array() const { return kind_ == Kind::kArray; }
  /// None: it is something else. A number with a fraction or beyond 64 bits is no integer.
  [[nodiscard]] std::optional<bool> boolean() const;
  [[nodiscard]] std::optional<std::int64_t> integer() const;
  [[nodiscard]] std::optional<double> number() const;
  [[nodiscard]] std::optional<std::string> text() const;

  [[nodiscard]] bool has(std::string_view key) const { return find(key) != nullptr; }
  /// Null if there is no such member.
  [[nodiscard]] const Json& at(std::string_view key) const;
  [[nodiscard]] Json* find(std::string_view key);
  [[nodiscard]] const Json* find(std::string_view key) const;
  /// Of an array its elements, of an object its members' values.
  [[nodiscard]] const std::vector<Json>& elements() const { return elements_; }
  [[nodiscard]] std::vector<Json>& elements() { return elements_; }
  [[nodiscard]] const std::vector<std::string>& keys() const { return keys_; }

  /// Lines with an indent of so many spaces, or one line. What is no UTF-8 is replaced.
  [[nodiscard]] std::string dump(int indent = -1) const;

 private:
  friend struct JsonCodec;
  enum class Kind { kNull, kBoolean, kSigned, kUnsigned, kReal, kText, kArray, kObject };

  void set(bool value);
  void set(std::int64_t value);
  void set(std::uint64_t value);
  void set(double value);

  Kind kind_ = Kind::kNull;
  union {
    bool boolean_;
    std::int64_t signed_ = 0;
    std::uint64_t unsigned_;
    double real_;
  };
  std::string text_;
  std::vector<std::string> keys_;  ///< of an object, as many as elements
  std::vector<Json> elements_;
};

struct Json::NamedValue {
  const char* key;
  Json value;
};

}  // namespace xauto

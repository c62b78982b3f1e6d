// SPDX-License-Identifier: Apache-2.0
// What include/xauto/parameter.h hides: a parameter as the library knows it, and its values.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <xauto/parameter.h>
#include <xauto/result.h>

namespace xauto {

/// Its index is the ParameterType.
using ParameterValue = std::variant<bool, std::int64_t, double, std::string>;
enum class ParameterType : std::uint32_t { kBoolean, kInteger, kReal, kText };
inline constexpr std::uint32_t kParameterTypes = 4;

inline constexpr std::size_t kMaxParameterName = 100, kMaxParameterText = 248;  ///< bytes
inline constexpr std::size_t kMaxModuleParameters = 256;
inline constexpr std::size_t kMaxParameters = 4096;  ///< of an app

[[nodiscard]] inline ParameterType type_of(const ParameterValue& value) {
  return static_cast<ParameterType>(value.index());
}
[[nodiscard]] const char* to_string(ParameterType type);
/// As `xauto param` prints and takes it: true, 12, 0.5, night.
[[nodiscard]] std::string to_text(const ParameterValue& value);

namespace detail {

struct ParameterSpec {
  std::string name;
  ParameterValue initial;
  ParameterValue least = false, most = false;  ///< of numbers, of the type of `initial`

  [[nodiscard]] ParameterType type() const { return type_of(initial); }
  /// "0 to 1"; "" of what is no number, and where every number is in it.
  [[nodiscard]] std::string range() const;
  /// What it becomes by being given `value`: 1 is a real number, too. Errors say what was wrong.
  [[nodiscard]] Result<ParameterValue> take(const ParameterValue& value) const;
  /// The same of what somebody typed.
  [[nodiscard]] Result<ParameterValue> take_text(std::string_view text) const;
  /// What is wrong with the declaration; "": nothing.
  [[nodiscard]] std::string misuse() const;
};

/// What an activation sees of one.
struct ParameterNow {
  const ParameterSpec* spec = nullptr;
  std::uint64_t bits = 0;  ///< of a bool 0 or 1, of an integer itself, of a double its bits
  std::string text;        ///< with room for the longest, so that it changes without allocating

  explicit ParameterNow(const ParameterSpec& of);
  void set(const ParameterValue& value);
};
[[nodiscard]] std::vector<ParameterNow> initial_of(const std::vector<ParameterHandle>& parameters);

}  // namespace detail

/// Bits of a bool, an integer or a double; of a text 0.
[[nodiscard]] std::uint64_t bits_of(const ParameterValue& value);
/// The other way round; of kText an empty one.
[[nodiscard]] ParameterValue from_bits(ParameterType type, std::uint64_t bits);

}  // namespace xauto

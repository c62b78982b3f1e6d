// SPDX-License-Identifier: Apache-2.0
// Parameters: values that a deployment sets and `xauto param` changes while the app runs.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace xauto {

class Input;
template <class State>
class XModule;
template <class State>
class XNode;
namespace testing {
class Fire;
}

namespace detail {

struct ParameterSpec;
using ParameterHandle = std::shared_ptr<const ParameterSpec>;

ParameterHandle make_parameter(std::string name, bool initial);
ParameterHandle make_parameter(std::string name, std::int64_t initial, std::int64_t least,
                               std::int64_t most);
ParameterHandle make_parameter(std::string name, double initial, double least, double most);
ParameterHandle make_parameter(std::string name, std::string initial);
const std::string& name_of(const ParameterSpec& parameter);

}  // namespace detail

/// A named value of a module: a bool, an integer, a double or a std::string. Declared by
/// XModule::add_parameter or XNode::add_parameter, read by Input::value. Its value is `initial`
/// unless deployment.json says another one; `xauto param set` changes it while the app runs.
///
///   const xauto::Parameter<double> threshold("threshold", 0.5, 0, 1);
///
/// A handle: copies are the same parameter. Two modules may declare it; each has a value of its own.
template <class T>
class Parameter {
  static_assert(std::is_integral_v<T> || std::is_same_v<T, double> ||
                    std::is_same_v<T, std::string>,
                "a parameter is a bool, an integer, a double or a std::string");
  static constexpr bool kNumber = !std::is_same_v<T, bool> && !std::is_same_v<T, std::string>;

 public:
  /// `name`: unique in its module; 1 to 100 bytes without control characters and "=". A text has at
  /// most 248 bytes, without control characters. What is wrong is told by App::check().
  Parameter(std::string name, T initial) {
    if constexpr (kNumber)
      spec_ = make(std::move(name), initial, std::numeric_limits<T>::lowest(),
                   std::numeric_limits<T>::max());
    else
      spec_ = detail::make_parameter(std::move(name), std::move(initial));
  }
  /// A number from `least` to `most`.
  Parameter(std::string name, T initial, T least, T most) requires(kNumber)
      : spec_(make(std::move(name), initial, least, most)) {}

  /// As given.
  [[nodiscard]] const std::string& name() const { return detail::name_of(*spec_); }

 private:
  friend class Input;
  template <class>
  friend class XModule;
  template <class>
  friend class XNode;
  friend class testing::Fire;

  static detail::ParameterHandle make(std::string name, T initial, T least, T most) {
    if constexpr (std::is_same_v<T, double>)
      return detail::make_parameter(std::move(name), initial, least, most);
    else
      return detail::make_parameter(std::move(name), clamped(initial), clamped(least),
                                    clamped(most));
  }
  /// What is beyond 63 bits cannot be said in JSON either.
  static std::int64_t clamped(T value) {
    if constexpr (std::is_unsigned_v<T> && sizeof(T) == 8)
      if (value > static_cast<T>(INT64_MAX)) return INT64_MAX;
    return static_cast<std::int64_t>(value);
  }

  detail::ParameterHandle spec_;
};

}  // namespace xauto

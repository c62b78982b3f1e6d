// SPDX-License-Identifier: Apache-2.0
// Messages full of numbers that depend on a seed; each sequence and text has another length.
#pragma once

#include <array>
#include <random>
#include <string>
#include <type_traits>
#include <vector>

#include <xauto/cdr.h>

namespace xauto::test {

class Filler {
 public:
  explicit Filler(unsigned seed) : random_(seed) {}

  template <class T>
  void operator()(T& value, std::uint32_t = 0, std::uint32_t = 0) {
    if constexpr (std::is_same_v<T, bool>)
      value = random_() % 2 == 1;
    else if constexpr (std::is_floating_point_v<T>)
      value = static_cast<T>(static_cast<int>(random_() % 20001) - 10000) / T{8};
    else if constexpr (std::is_integral_v<T>)
      value = static_cast<T>(random_());
    else
      Interface<T>::fields(value, *this);
  }
  void operator()(std::string& text, std::uint32_t bound = cdr::kUnbounded, std::uint32_t = 0) {
    text.assign(length(bound), static_cast<char>('a' + random_() % 26));
  }
  void operator()(std::u16string& text, std::uint32_t bound = cdr::kUnbounded, std::uint32_t = 0) {
    text.assign(length(bound), static_cast<char16_t>(0x3b1 + random_() % 20));
  }
  template <class T>
  void operator()(std::vector<T>& values, std::uint32_t bound = cdr::kUnbounded,
                  std::uint32_t inner = cdr::kUnbounded) {
    values.resize(length(bound));
    for (std::size_t i = 0; i < values.size(); ++i) {
      T value{};
      (*this)(value, inner);
      values[i] = std::move(value);
    }
  }
  template <class T, std::size_t N>
  void operator()(std::array<T, N>& values, std::uint32_t inner = cdr::kUnbounded) {
    for (T& value : values) (*this)(value, inner);
  }

 private:
  std::size_t length(std::uint32_t bound) {
    return random_() % (std::min<std::size_t>(bound, 9) + 1);
  }
  std::mt19937_64 random_;
};

template <class T>
T filled(unsigned seed) {
  T message;
  Filler fill(seed);
  fill(message);
  return message;
}

}  // namespace xauto::test

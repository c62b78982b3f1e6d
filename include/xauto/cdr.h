// SPDX-License-Identifier: Apache-2.0
// Messages of .msg and .idl files as bytes, as ROS 2 sends and records them: an encapsulation header
// and plain CDR (OMG XTypes 1.3, 7.4.1, version 1 of the encoding). Little endian is written, both
// byte orders are read. `xauto_add_messages` (docs/interop.md) makes headers that use this one; a
// program has no other reason to include it.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <xauto/topic.h>

namespace xauto {

/// What is known of a message type of a .msg or .idl file. The made headers specialise it:
///   kName     "sensor_msgs/msg/Image"
///   kSchema   its definition and those of the types in it, as MCAP's "ros2msg" has them
///   fields    calls a function for each field, in order; its bounds are further arguments
///   stamp_ns  where the first field is a std_msgs/Header: its stamp, ns since 1970
template <class T>
struct Interface;

/// Plain CDR. Of all this a program needs nothing: the headers that `xauto_add_messages` makes use it.
/// @cond
namespace cdr {

inline constexpr std::size_t kHeaderBytes = 4;  ///< of the encapsulation header
inline constexpr std::uint32_t kUnbounded = std::numeric_limits<std::uint32_t>::max();

template <class T>
inline constexpr bool kPrimitive = std::is_arithmetic_v<T>;

/// ROS 2's Cyclone writes each UTF-16 unit of a wstring as a wchar_t of Linux.
inline constexpr std::size_t kWideBytes = 4;

/// What both sides of an element share: the bounds of a field go to whatever they bound. `bound` is
/// that of a sequence or text, `inner` that of texts in a sequence or array.
inline void check_bound(std::size_t count, std::uint32_t bound, const char* what) {
  if (count > bound)
    throw std::length_error(std::string(what) + " of " + std::to_string(count) +
                            " elements, at most " + std::to_string(bound) + " are allowed");
}

/// How many bytes a message takes. Throws std::length_error where a field exceeds its bound.
class Sizer {
 public:
  [[nodiscard]] std::size_t bytes() const { return at_; }

  template <class T>
  void operator()(const T& value, std::uint32_t bound = kUnbounded,
                  std::uint32_t inner = kUnbounded) {
    (void)bound, (void)inner;
    if constexpr (kPrimitive<T>)
      add(sizeof(T), 1);
    else
      Interface<T>::fields(value, *this);
  }
  void operator()(const std::string& text, std::uint32_t bound = kUnbounded,
                  std::uint32_t = kUnbounded) {
    check_bound(text.size(), std::min(bound, kUnbounded - 1), "string");  // its end mark counts
    add(4, 1);
    at_ += text.size() + 1;
  }
  void operator()(const std::u16string& text, std::uint32_t bound = kUnbounded,
                  std::uint32_t = kUnbounded) {
    check_bound(text.size(), bound, "wstring");
    add(4, 1);
    at_ += text.size() * kWideBytes;
  }
  template <class T>
  void operator()(const std::vector<T>& values, std::uint32_t bound = kUnbounded,
                  std::uint32_t inner = kUnbounded) {
    check_bound(values.size(), bound, "sequence");
    add(4, 1);
    if constexpr (kPrimitive<T>) {
      if (!values.empty()) add(sizeof(T), values.size());
    } else {
      for (const T& value : values) (*this)(value, inner);
    }
  }
  template <class T, std::size_t N>
  void operator()(const std::array<T, N>& values, std::uint32_t inner = kUnbounded) {
    if constexpr (kPrimitive<T>)
      add(sizeof(T), N);
    else
      for (const T& value : values) (*this)(value, inner);
  }

 private:
  void add(std::size_t size, std::size_t count) {
    at_ = (at_ + size - 1) / size * size + size * count;
  }
  std::size_t at_ = 0;
};

/// Writes a message behind its encapsulation header. The room is what Sizer has said.
class Writer {
 public:
  explicit Writer(std::span<std::byte> room) : at_(room.data()), begin_(at_), left_(room.size()) {}

  template <class T>
  void operator()(const T& value, std::uint32_t = kUnbounded, std::uint32_t = kUnbounded) {
    if constexpr (kPrimitive<T>) {
      align(sizeof(T));
      put_all(&value, 1);
    } else {
      Interface<T>::fields(value, *this);
    }
  }
  void operator()(const std::string& text, std::uint32_t = kUnbounded, std::uint32_t = kUnbounded) {
    count(text.size() + 1);
    put(text.c_str(), text.size() + 1);
  }
  void operator()(const std::u16string& text, std::uint32_t = kUnbounded,
                  std::uint32_t = kUnbounded) {
    count(text.size());
    for (const char16_t unit : text) (*this)(std::uint32_t{unit});
  }
  template <class T>
  void operator()(const std::vector<T>& values, std::uint32_t = kUnbounded,
                  std::uint32_t = kUnbounded) {
    count(values.size());
    if constexpr (std::is_same_v<T, bool>) {
      for (const bool value : values) (*this)(value);
    } else if constexpr (kPrimitive<T>) {
      if (values.empty()) return;
      align(sizeof(T));
      put_all(values.data(), values.size());
    } else {
      for (const T& value : values) (*this)(value);
    }
  }
  template <class T, std::size_t N>
  void operator()(const std::array<T, N>& values, std::uint32_t = kUnbounded) {
    if constexpr (kPrimitive<T>) {
      align(sizeof(T));
      put_all(values.data(), N);
    } else {
      for (const T& value : values) (*this)(value);
    }
  }

 private:
  void count(std::size_t n) { (*this)(static_cast<std::uint32_t>(n)); }
  void align(std::size_t size) {
    static constexpr std::byte kNothing[8] = {};
    put(kNothing, (size - static_cast<std::size_t>(at_ - begin_) % size) % size);
  }
  template <class T>
  void put_all(const T* values, std::size_t n) {
    if constexpr (std::endian::native == std::endian::little || sizeof(T) == 1) {
      put(values, n * sizeof(T));
    } else {
      for (std::size_t i = 0; i < n; ++i) {
        std::byte bytes[sizeof(T)];
        std::memcpy(bytes, values + i, sizeof(T));
        std::reverse(std::begin(bytes), std::end(bytes));
        put(bytes, sizeof(T));
      }
    }
  }
  void put(const void* from, std::size_t bytes) {
    if (bytes > left_) throw std::length_error("message that changed while it was encoded");
    if (bytes > 0) std::memcpy(at_, from, bytes);
    at_ += bytes;
    left_ -= bytes;
  }
  std::byte* at_;
  const std::byte* const begin_;
  std::size_t left_;
};

/// Reads what may come from anybody: throws std::runtime_error when the bytes are no such message.
/// Memory grows with the bytes that are there, not with what they claim.
class Reader {
 public:
  /// `swap`: they are of the other byte order.
  Reader(std::span<const std::byte> bytes, bool swap)
      : at_(bytes.data()), begin_(at_), left_(bytes.size()), swap_(swap) {}

  [[nodiscard]] std::size_t left() const { return left_; }

  template <class T>
  void operator()(T& value, std::uint32_t = kUnbounded, std::uint32_t = kUnbounded) {
    if constexpr (std::is_same_v<T, bool>) {
      value = read_bool();
    } else if constexpr (kPrimitive<T>) {
      align(sizeof(T));
      value = value_at<T>(take(sizeof(T)));
    } else {
      Interface<T>::fields(value, *this);
    }
  }
  void operator()(std::string& text, std::uint32_t bound = kUnbounded, std::uint32_t = kUnbounded) {
    const std::size_t size = count();
    if (size == 0) return text.clear();  // some write an empty text so
    const auto* from = reinterpret_cast<const char*>(take(size));
    if (from[size - 1] != '\0') throw std::runtime_error("string without its end");
    check(size - 1, bound);
    text.assign(from, size - 1);
  }
  void operator()(std::u16string& text, std::uint32_t bound = kUnbounded,
                  std::uint32_t = kUnbounded) {
    const std::size_t size = count();
    check(size, bound);
    if (size > left_ / kWideBytes) throw std::runtime_error("wstring beyond the end");
    text.clear();
    for (std::size_t i = 0; i < size; ++i) {
      std::uint32_t unit = 0;
      (*this)(unit);
      if (unit > 0xffff) throw std::runtime_error("wstring that is not UTF-16");
      text.push_back(static_cast<char16_t>(unit));
    }
  }
  template <class T>
  void operator()(std::vector<T>& values, std::uint32_t bound = kUnbounded,
                  std::uint32_t inner = kUnbounded) {
    const std::size_t n = count();
    check(n, bound);
    values.clear();
    if (n == 0) return;
    if (n > left_) throw std::runtime_error("sequence beyond the end");  // an element has a byte
    if constexpr (kPrimitive<T> && !std::is_same_v<T, bool>) {
      align(sizeof(T));
      if (n > left_ / sizeof(T)) throw std::runtime_error("sequence beyond the end");
      const std::byte* from = take(n * sizeof(T));
      if constexpr (sizeof(T) == 1) {
        const auto* first = reinterpret_cast<const unsigned char*>(from);
        values.assign(first, first + n);
      } else {
        values.assign(Elements<T>{this, from}, Elements<T>{this, from + n * sizeof(T)});
      }
    } else {
      for (std::size_t i = 0; i < n; ++i) {
        if constexpr (std::is_same_v<T, bool>)
          values.push_back(read_bool());
        else
          (*this)(values.emplace_back(), inner);
      }
    }
  }
  template <class T, std::size_t N>
  void operator()(std::array<T, N>& values, std::uint32_t inner = kUnbounded) {
    for (T& value : values) (*this)(value, inner);
  }

 private:
  /// The elements of a sequence where they lie, whatever the alignment: `assign` fills a vector from
  /// these without writing zeros first.
  template <class T>
  struct Elements {
    using iterator_category = std::random_access_iterator_tag;
    using value_type = T;
    using difference_type = std::ptrdiff_t;
    using pointer = const T*;
    using reference = T;
    const Reader* reader;
    const std::byte* at;
    T operator*() const { return reader->value_at<T>(at); }
    Elements& operator+=(difference_type n) {
      at += n * static_cast<difference_type>(sizeof(T));
      return *this;
    }
    Elements& operator++() { return *this += 1; }
    Elements& operator--() { return *this += -1; }
    difference_type operator-(const Elements& other) const {
      return (at - other.at) / static_cast<difference_type>(sizeof(T));
    }
    bool operator==(const Elements& other) const { return at == other.at; }
    bool operator!=(const Elements& other) const { return at != other.at; }
  };

  static void check(std::size_t n, std::uint32_t bound) {
    if (n > bound) throw std::runtime_error("field that is longer than its bound");
  }
  bool read_bool() {
    const auto byte = static_cast<unsigned char>(*take(1));
    if (byte > 1) throw std::runtime_error("bool that is neither 0 nor 1");
    return byte == 1;
  }
  std::size_t count() {
    std::uint32_t n = 0;
    (*this)(n);
    return n;
  }
  void align(std::size_t size) {
    (void)take((size - static_cast<std::size_t>(at_ - begin_) % size) % size);
  }
  const std::byte* take(std::size_t bytes) {
    if (bytes > left_) throw std::runtime_error("message that ends too early");
    const std::byte* from = at_;
    at_ += bytes;
    left_ -= bytes;
    return from;
  }
  template <class T>
  [[nodiscard]] T value_at(const std::byte* from) const {
    T value;
    if (sizeof(T) > 1 && swap_) {
      std::byte bytes[sizeof(T)];
      std::reverse_copy(from, from + sizeof(T), bytes);
      std::memcpy(&value, bytes, sizeof(T));
    } else {
      std::memcpy(&value, from, sizeof(T));
    }
    return value;
  }
  const std::byte* at_;
  const std::byte* const begin_;
  std::size_t left_;
  const bool swap_;
};

/// Codec<T> of a type that has an Interface. `encode` throws std::length_error where a field exceeds
/// its bound, `decode` std::runtime_error where the bytes are no T.
template <class T>
struct MessageCodec {
  static constexpr bool kAvailable = true;  ///< yes
  /// How many bytes it takes, the encapsulation header included.
  static std::size_t encoded_bytes(const T& message) {
    Sizer sizer;
    sizer(message);
    return kHeaderBytes + sizer.bytes();
  }
  /// Into room of encoded_bytes(message).
  static void encode_into(const T& message, std::span<std::byte> room) {
    static constexpr std::byte kLittleEndian[kHeaderBytes] = {std::byte{0}, std::byte{1}};
    std::copy(std::begin(kLittleEndian), std::end(kLittleEndian), room.begin());
    Writer write(room.subspan(kHeaderBytes));
    write(message);
  }
  /// The bytes of a message.
  static std::vector<std::byte> encode(const T& message) {
    std::vector<std::byte> bytes(encoded_bytes(message));
    encode_into(message, bytes);
    return bytes;
  }
  /// Makes `message`, a new one, of these bytes. Up to three more may follow: DDS sends multiples of
  /// four.
  static void decode_into(T& message, std::span<const std::byte> bytes) {
    if (bytes.size() < kHeaderBytes || bytes[0] != std::byte{0} || bytes[1] > std::byte{1})
      throw std::runtime_error("message that is not plain CDR");
    const bool little = bytes[1] == std::byte{1};
    Reader read(bytes.subspan(kHeaderBytes),
                little != (std::endian::native == std::endian::little));
    read(message);
    if (read.left() > 3) throw std::runtime_error("message that goes on behind its end");
  }
  /// A message of these bytes, likewise.
  static T decode(std::span<const std::byte> bytes) {
    T message;
    decode_into(message, bytes);
    return message;
  }
};

}  // namespace cdr
/// @endcond
}  // namespace xauto

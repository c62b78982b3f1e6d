// SPDX-License-Identifier: Apache-2.0
// Typed topics and what travels on them.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <typeindex>
#include <vector>

namespace xauto {

/// A name and a message type. A value: copies name the same topic. Two modules that use one name
/// with two types are refused when the App is built.
template <class T>
class Topic {
 public:
  using Message = T;  ///< what travels on it
  /// `name` is the topic's; two topics of one name are the same topic.
  explicit Topic(std::string name) : name_(std::move(name)) {}
  /// As given.
  [[nodiscard]] const std::string& name() const { return name_; }

 private:
  std::string name_;
};

/// How messages become bytes, for recorded inputs. Plain data and byte strings work as they are;
/// for any other type specialise it. `decode` throws std::exception when the bytes are not a T.
/// Plain data is stored in the memory layout of this machine: declare it without padding.
template <class T, class Enable = void>
struct Codec {
  /// Whether the type can leave the process and be recorded.
  static constexpr bool kAvailable = false;
};
/// Plain data: its bytes.
template <class T>
struct Codec<T, std::enable_if_t<std::is_trivially_copyable_v<T> && !std::is_pointer_v<T>>> {
  static constexpr bool kAvailable = true;  ///< yes
  /// The bytes of a message.
  static std::vector<std::byte> encode(const T& message) {
    std::vector<std::byte> bytes(sizeof(T));
    std::memcpy(bytes.data(), &message, sizeof(T));
    return bytes;
  }
  /// A message of these bytes; throws std::runtime_error when there are more or fewer than a T has.
  static T decode(std::span<const std::byte> bytes) {
    if (bytes.size() != sizeof(T))
      throw std::runtime_error("message of " + std::to_string(bytes.size()) + " bytes, expected " +
                               std::to_string(sizeof(T)));
    T message;
    std::memcpy(&message, bytes.data(), sizeof(T));
    return message;
  }
};
/// Bytes, as they are.
template <>
struct Codec<std::vector<std::byte>> {
  static constexpr bool kAvailable = true;  ///< yes
  /// The bytes of a message.
  static std::vector<std::byte> encode(const std::vector<std::byte>& m) { return m; }
  /// A message of these bytes.
  static std::vector<std::byte> decode(std::span<const std::byte> b) {
    return {b.begin(), b.end()};
  }
};
/// Text, without an end mark.
template <>
struct Codec<std::string> {
  static constexpr bool kAvailable = true;  ///< yes
  /// The bytes of a message.
  static std::vector<std::byte> encode(const std::string& m) {
    const auto* data = reinterpret_cast<const std::byte*>(m.data());
    return {data, data + m.size()};
  }
  /// A message of these bytes.
  static std::string decode(std::span<const std::byte> b) {
    return {reinterpret_cast<const char*>(b.data()), b.size()};
  }
};

/// Where a message is made so that other processes can read it without a copy. Implemented by the
/// transport; apps meet it only through Topic.
class MessageMemory {
 public:
  virtual ~MessageMemory() = default;
  /// Room for `bytes`, given back when nobody holds it any more; null: make it on the heap.
  virtual std::shared_ptr<void> loan(std::size_t bytes) = 0;
};

namespace detail {

/// Release times by source, of an app whose sources have several periods; 0: not involved.
inline constexpr std::size_t kMaxOrigins = 8;  ///< further sources are known by the oldest only
using Origins = std::array<std::int64_t, kMaxOrigins>;

/// A message on its way: shared, never written again once published.
struct Envelope {
  std::shared_ptr<const void> message;  ///< null: dropped upstream, see `Input` and docs/runtime.md
  std::int64_t origin_ns = 0;           ///< CLOCK_MONOTONIC time at which the sensor released it
  std::uint64_t sequence = 0;           ///< number of that release
  std::shared_ptr<const Origins> origins = {};  ///< null in an app of one rate
};

struct TopicSpec {
  std::string name;
  std::type_index type = typeid(void);
  std::string type_name;
  /// Null where the type has no Codec.
  std::vector<std::byte> (*encode)(const void*) = nullptr;
  std::shared_ptr<const void> (*decode)(std::span<const std::byte>) = nullptr;
  /// sizeof(T) of plain data, which other processes read where it lies; 0: it is encoded.
  std::size_t plain_bytes = 0;
  /// Largest encoded message between processes: Codec<T>::kMaxBytes, if it says so.
  std::size_t max_bytes = std::size_t{8} << 20;
};

/// A message of type T from `make`, a callable that returns a T, without a copy: in `memory` if T
/// is plain data and there is room, else on the heap.
template <class T, class Make>
std::shared_ptr<const void> make_message(MessageMemory* memory, Make&& make) {
  if constexpr (std::is_trivially_copyable_v<T> && !std::is_pointer_v<T> && alignof(T) <= 64)
    if (memory != nullptr)
      if (std::shared_ptr<void> room = memory->loan(sizeof(T))) {
        ::new (room.get()) T(make());
        return room;
      }
  return std::make_shared<const T>(make());
}

std::string demangle(const char* name);

template <class T>
TopicSpec topic_spec(const Topic<T>& topic) {
  TopicSpec spec;
  spec.name = topic.name();
  spec.type = typeid(T);
  spec.type_name = demangle(typeid(T).name());
  if constexpr (Codec<T>::kAvailable) {
    spec.encode = [](const void* m) { return Codec<T>::encode(*static_cast<const T*>(m)); };
    spec.decode = [](std::span<const std::byte> b) -> std::shared_ptr<const void> {
      return std::make_shared<const T>(Codec<T>::decode(b));
    };
    if constexpr (requires { Codec<T>::kMaxBytes; }) spec.max_bytes = Codec<T>::kMaxBytes;
  }
  if constexpr (std::is_trivially_copyable_v<T> && !std::is_pointer_v<T>)
    spec.plain_bytes = sizeof(T);
  return spec;
}

}  // namespace detail

/// What `exec` sees of the messages that fired its module. Valid during the call, and for the
/// following XNodes of the same activation; a message lives as long as somebody holds it.
class Input {
 public:
  /// The message of an input topic of this module. Throws std::logic_error if it is not one.
  template <class T>
  [[nodiscard]] const T& get(const Topic<T>& topic) const {
    return *static_cast<const T*>(find(topic.name(), typeid(T)).message.get());
  }
  /// The same, shared: to keep a message in the state without copying it.
  template <class T>
  [[nodiscard]] std::shared_ptr<const T> share(const Topic<T>& topic) const {
    return std::static_pointer_cast<const T>(find(topic.name(), typeid(T)).message);
  }
  /// Release time of the oldest message of this activation at its sensor, CLOCK_MONOTONIC.
  [[nodiscard]] std::chrono::nanoseconds origin() const {
    return std::chrono::nanoseconds(origin_ns_);
  }
  /// Number of that release, from 0 on.
  [[nodiscard]] std::uint64_t sequence() const { return sequence_; }

 private:
  friend class InputAccess;  // lib/runtime fills it
  [[nodiscard]] const detail::Envelope& find(const std::string& topic, std::type_index type) const;

  const std::vector<detail::TopicSpec>* topics_ = nullptr;
  std::vector<detail::Envelope> messages_;
  std::int64_t origin_ns_ = 0;
  std::uint64_t sequence_ = 0;
};

}  // namespace xauto

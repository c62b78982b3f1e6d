// SPDX-License-Identifier: Apache-2.0
// Typed topics and what travels on them.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <typeinfo>
#include <utility>
#include <vector>

#include <xauto/parameter.h>

namespace xauto {

template <class T>
struct Interface;  // of types made from .msg and .idl files, see xauto/cdr.h

/// The largest `sizeof` of a message. Functions take and return messages, so one is on a thread's stack
/// now and then. What is in a std::vector, or in a Buffer, does not count.
inline constexpr std::size_t kMaxMessageSize = std::size_t{1} << 20;

/// A name and a message type. A value: copies name the same topic. Two modules that use one name
/// with two types are refused when the App is built.
template <class T>
class Topic {
 public:
  using Message = T;  ///< what travels on it
  /// `name` is the topic's; two topics of one name are the same topic.
  explicit Topic(std::string name) : name_(std::move(name)) {
    // Nothing takes or holds messages without their topic.
    static_assert(
        sizeof(T) <= kMaxMessageSize,
        "a message of more than xauto::kMaxMessageSize bytes does not fit on a stack: put "
        "them into an xauto::Buffer (xauto::Buffered<Info>), or into a std::vector");
  }
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

// What follows is how the templates here talk to the library: functions that it exports, and types
// whose layout it alone knows. So it can learn more without programs being built again.
namespace detail {

struct TopicSpec;
struct InputData;
class MessageMemory;
using TopicHandle = std::shared_ptr<const TopicSpec>;
using Encode = std::vector<std::byte> (*)(const void*);
using Decode = std::shared_ptr<const void> (*)(std::span<const std::byte>);
using EncodedBytes = std::size_t (*)(const void*);
using EncodeInto = void (*)(const void*, std::span<std::byte>);
using DecodeInto = void (*)(void*, std::span<const std::byte>);
using StampNs = std::int64_t (*)(const void*);

std::shared_ptr<TopicSpec> make_topic(const std::string& name, const std::type_info& type);
/// Of a name alone: what it carries says a Topic of that name elsewhere in the app.
TopicHandle make_topic(const std::string& name);
void set_codec(TopicSpec& topic, Encode encode, Decode decode);
/// Into a message that somebody had before; throws as decode does.
void set_decode_into(TopicSpec& topic, DecodeInto decode);
/// Of an encoded message; 8 MiB unless said.
void set_max_bytes(TopicSpec& topic, std::size_t bytes);
void set_plain_bytes(TopicSpec& topic, std::size_t bytes);
/// Of a .msg or .idl file, see xauto/cdr.h. `name` and `schema` are constants of the program;
/// `stamp_ns` null: it has no header.
void set_interface(TopicSpec& topic, const char* name, const char* schema, EncodedBytes bytes,
                   EncodeInto encode, StampNs stamp_ns);
/// Room for a message where other processes can read it; null: there is none, use the heap.
std::shared_ptr<void> loan(MessageMemory* memory, std::size_t bytes);

/// A message of type T from `make`, a callable that returns a T, without a copy. It is in `memory`
/// if T is plain data and there is room, else on the heap.
template <class T, class Make>
std::shared_ptr<const void> make_message(MessageMemory* memory, Make&& make) {
  if constexpr (std::is_trivially_copyable_v<T> && !std::is_pointer_v<T> && alignof(T) <= 64)
    if (memory != nullptr)
      if (std::shared_ptr<void> room = loan(memory, sizeof(T))) {
        ::new (room.get()) T(make());
        return room;
      }
  return std::make_shared<const T>(make());
}

template <class T>
TopicHandle topic_spec(const Topic<T>& topic) {
  std::shared_ptr<TopicSpec> spec = make_topic(topic.name(), typeid(T));
  if constexpr (Codec<T>::kAvailable) {
    set_codec(
        *spec, [](const void* m) { return Codec<T>::encode(*static_cast<const T*>(m)); },
        [](std::span<const std::byte> b) -> std::shared_ptr<const void> {
          if constexpr (requires(T & m) { Codec<T>::decode_into(m, b); }) {
            auto message = std::make_shared<T>();  // which may be too large for the stack
            Codec<T>::decode_into(*message, b);
            return message;
          } else {
            return std::make_shared<const T>(Codec<T>::decode(b));
          }
        });
    if constexpr (requires(T & m, std::span<const std::byte> b) { Codec<T>::decode_into(m, b); })
      set_decode_into(*spec, [](void* m, std::span<const std::byte> b) {
        Codec<T>::decode_into(*static_cast<T*>(m), b);
      });
    if constexpr (requires { Codec<T>::kMaxBytes; }) set_max_bytes(*spec, Codec<T>::kMaxBytes);
  }
  if constexpr (std::is_trivially_copyable_v<T> && !std::is_pointer_v<T>)
    set_plain_bytes(*spec, sizeof(T));
  if constexpr (requires { Codec<T>::describe(*spec); }) Codec<T>::describe(*spec);
  if constexpr (requires { Interface<T>::kName; }) {
    StampNs stamp_ns = nullptr;
    if constexpr (requires(const T& m) { Interface<T>::stamp_ns(m); })
      stamp_ns = [](const void* m) { return Interface<T>::stamp_ns(*static_cast<const T*>(m)); };
    set_interface(
        *spec, Interface<T>::kName, Interface<T>::kSchema,
        [](const void* m) { return Codec<T>::encoded_bytes(*static_cast<const T*>(m)); },
        [](const void* m, std::span<std::byte> room) {
          Codec<T>::encode_into(*static_cast<const T*>(m), room);
        },
        stamp_ns);
  }
  return spec;
}

}  // namespace detail

/// What `exec` sees of the messages that fired its module. Valid during the call, and for the
/// following XNodes of the same activation; a message lives as long as somebody holds it.
class Input {
 public:
  ~Input();
  Input(const Input&) = delete;
  Input& operator=(const Input&) = delete;

  /// The message of an input topic of this module. Throws std::logic_error if it is not one.
  template <class T>
  [[nodiscard]] const T& get(const Topic<T>& topic) const {
    return *static_cast<const T*>(find(topic.name(), typeid(T)).get());
  }
  /// The same by its name: get<T>("name"). Throws as well if it carries another type.
  template <class T>
  [[nodiscard]] const T& get(const std::string& topic) const {
    return *static_cast<const T*>(find(topic, typeid(T)).get());
  }
  /// The same, shared: to keep a message in the state without copying it.
  template <class T>
  [[nodiscard]] std::shared_ptr<const T> share(const Topic<T>& topic) const {
    return std::static_pointer_cast<const T>(find(topic.name(), typeid(T)));
  }
  /// The newest message of a sampled topic when the activation began to run; null: none had come
  /// yet, or it was too old. Throws std::logic_error if it is no sampled topic of this module.
  template <class T>
  [[nodiscard]] const T* sampled(const Topic<T>& topic) const {
    return static_cast<const T*>(sample(topic.name(), typeid(T)).get());
  }
  /// The same, shared: to keep it in the state without copying it.
  template <class T>
  [[nodiscard]] std::shared_ptr<const T> share_sampled(const Topic<T>& topic) const {
    return std::static_pointer_cast<const T>(sample(topic.name(), typeid(T)));
  }
  /// How old the message of an input or sampled topic is; where the module samples topics, was when
  /// the activation began to run. Since the release at the sensor, the oldest of those that fired
  /// the modules which made it. What these modules sampled may be older. Negative: there is none.
  /// Throws std::logic_error if it is neither an input nor a sampled topic of this module.
  template <class T>
  [[nodiscard]] std::chrono::nanoseconds age(const Topic<T>& topic) const {
    return age_of(topic.name());
  }
  /// Release time of the oldest message of this activation at its sensor, CLOCK_MONOTONIC. In a run
  /// by keys the nominal one, of the earliest source of the module's component.
  [[nodiscard]] std::chrono::nanoseconds origin() const;
  /// By when the XNode that asks is to end, CLOCK_MONOTONIC: its release and the key that the plan
  /// gave it. Who ends later may make others late, so an exec may choose the shorter of two ways.
  /// Nullopt where nothing says: no run by keys, or no XNode that asks.
  [[nodiscard]] std::optional<std::chrono::nanoseconds> due() const;
  /// By when the module's result is to be there, CLOCK_MONOTONIC: the same of its last XNode. The
  /// worst case that is left is this less the present; it holds while the run's assumptions do.
  [[nodiscard]] std::optional<std::chrono::nanoseconds> result_due() const;
  /// Whether the XNode that asks would end by due() if it went on for `way` from now, undisturbed.
  /// True where nothing says. The certificate allows for no more than the WCET of the plan. `way`,
  /// and what the XNode did before it asked, must be within that, whatever the answer is. Costs one
  /// reading of the clock.
  [[nodiscard]] bool time_for(std::chrono::nanoseconds way) const;
  /// Number of that release, from 0 on.
  [[nodiscard]] std::uint64_t sequence() const;

  /// The value that a parameter of this module had when the activation began. All its XNodes see
  /// the same, and the parameters of a module that are set together change together. No lock, no
  /// allocation. Throws std::logic_error if neither this module nor one of its XNodes declares it.
  template <class T>
  [[nodiscard]] decltype(auto) value(const Parameter<T>& parameter) const {
    if constexpr (std::is_same_v<T, std::string>)
      return text_of(*parameter.spec_);
    else if constexpr (std::is_same_v<T, double>)
      return real_of(*parameter.spec_);
    else
      return static_cast<T>(integer_of(*parameter.spec_));
  }

 private:
  friend class InputAccess;  // lib/runtime fills it
  Input();
  [[nodiscard]] const std::shared_ptr<const void>& find(const std::string& topic,
                                                        const std::type_info& type) const;
  [[nodiscard]] const std::shared_ptr<const void>& sample(const std::string& topic,
                                                          const std::type_info& type) const;
  [[nodiscard]] std::chrono::nanoseconds age_of(const std::string& topic) const;
  [[nodiscard]] std::int64_t integer_of(const detail::ParameterSpec& parameter) const;
  [[nodiscard]] double real_of(const detail::ParameterSpec& parameter) const;
  [[nodiscard]] const std::string& text_of(const detail::ParameterSpec& parameter) const;
  std::unique_ptr<detail::InputData> data_;
};

}  // namespace xauto

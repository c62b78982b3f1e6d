// SPDX-License-Identifier: Apache-2.0
#include "transport/cyclonedds/wire.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <ctime>

#include <xauto/cdr.h>

#include "base/clock.h"

namespace xauto::transport {
namespace {

/// xauto_msgs/msg/Message without its data: builtin_interfaces/Time stamp, uint64 number, and the
/// length of uint8[] data.
struct Front {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
  std::uint64_t number = 0;
  std::uint32_t bytes = 0;
  static constexpr std::size_t kBytes = 20;

  template <class Visit>
  void fields(Visit& visit) {
    visit(sec);
    visit(nanosec);
    visit(number);
    visit(bytes);
  }
};

std::int64_t wall_ns() {
  timespec wall{};
  clock_gettime(CLOCK_REALTIME, &wall);
  return static_cast<std::int64_t>(wall.tv_sec) * 1'000'000'000 + wall.tv_nsec;
}

/// The header says how many bytes DDS adds.
void say_padding(Sample& sample) {
  sample.bytes()[3] = static_cast<std::byte>((4 - sample.size % 4) % 4);
}

}  // namespace

std::string Wire::type_name() const {
  const std::string name = native() ? spec_.ros_type : "xauto_msgs/msg/Message";
  const std::size_t package = name.find('/'), type = name.rfind('/');
  return name.substr(0, package) + "::msg::dds_::" + name.substr(type + 1) + "_";
}

std::size_t Wire::largest() const {
  if (spec_.plain_bytes == 0) return spec_.max_bytes;
  // CDR has no gap that the struct has not.
  return native() ? cdr::kHeaderBytes + spec_.plain_bytes + 3 : spec_.plain_bytes;
}

SamplePtr Wire::encode(const ddsi_sertype& type, const detail::Envelope& envelope) const try {
  const void* message = envelope.message.get();
  if (native()) {
    const std::size_t size = spec_.encoded_bytes(message);
    if (size > largest()) return nullptr;
    SamplePtr sample = make_sample(type, size);
    if (sample == nullptr) return nullptr;
    spec_.encode_into(message, sample->bytes());
    say_padding(*sample);
    return sample;
  }
  std::vector<std::byte> encoded;
  std::span<const std::byte> data{static_cast<const std::byte*>(message), spec_.plain_bytes};
  if (spec_.plain_bytes == 0) data = encoded = spec_.encode(message);
  if (data.size() > largest()) return nullptr;
  SamplePtr sample = make_sample(type, cdr::kHeaderBytes + Front::kBytes + data.size());
  if (sample == nullptr) return nullptr;
  const std::int64_t stamp = wall_ns() - (now_ns() - envelope.origin_ns);
  Front front{static_cast<std::int32_t>(stamp / 1'000'000'000),
              static_cast<std::uint32_t>(stamp % 1'000'000'000), envelope.sequence,
              static_cast<std::uint32_t>(data.size())};
  const std::span<std::byte> room = sample->bytes();
  std::fill_n(room.data(), cdr::kHeaderBytes, std::byte{0});
  room[1] = std::byte{1};
  cdr::Writer writer(room.subspan(cdr::kHeaderBytes, Front::kBytes));
  front.fields(writer);
  if (!data.empty())
    std::memcpy(room.data() + cdr::kHeaderBytes + Front::kBytes, data.data(), data.size());
  say_padding(*sample);
  return sample;
} catch (...) {  // the program's Codec, or no memory
  return nullptr;
}

std::optional<Wire::Received> Wire::decode(std::span<const std::byte> bytes,
                                           bool with_message) const try {
  Received received;
  if (native()) {
    if (bytes.size() > largest() + 3) return std::nullopt;
    if (!with_message) return received;
    received.message = kept_->decode(spec_, bytes);
    received.stamped = spec_.stamp_ns != nullptr;
    if (received.stamped) received.stamp_ns = spec_.stamp_ns(received.message.get());
    return received;
  }
  if (bytes.size() < cdr::kHeaderBytes + Front::kBytes || bytes[0] != std::byte{0} ||
      bytes[1] > std::byte{1})
    return std::nullopt;
  const bool little = bytes[1] == std::byte{1};
  cdr::Reader reader(bytes.subspan(cdr::kHeaderBytes),
                     little != (std::endian::native == std::endian::little));
  Front front;
  front.fields(reader);
  if (front.bytes > largest() || front.bytes > reader.left() || reader.left() - front.bytes > 3)
    return std::nullopt;
  received.sequence = front.number;
  received.stamped = true;
  received.stamp_ns = std::int64_t{front.sec} * 1'000'000'000 + front.nanosec;
  if (with_message)
    received.message =
        kept_->decode(spec_, bytes.subspan(cdr::kHeaderBytes + Front::kBytes, front.bytes));
  return received;
} catch (...) {  // not a message of this type
  return std::nullopt;
}

}  // namespace xauto::transport

// SPDX-License-Identifier: Apache-2.0
// What a topic's messages are for DDS. A type of a .msg or .idl file is that type. Any other is
// xauto_msgs/msg/Message (docs/interop.md): when the sensor released it, which release it is, and
// the bytes of xauto::Codec, which for plain data are its memory.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "model/message.h"
#include "transport/cyclonedds/sample.h"
#include "transport/kept_messages.h"

namespace xauto::transport {

/// Threads: any.
class Wire {
 public:
  explicit Wire(detail::TopicSpec spec) : spec_(std::move(spec)) {}

  [[nodiscard]] const detail::TopicSpec& spec() const { return spec_; }
  /// As DDS has it: "sensor_msgs::msg::dds_::Image_".
  [[nodiscard]] std::string type_name() const;
  /// Null: the message cannot be encoded, or is larger than the topic's largest.
  [[nodiscard]] SamplePtr encode(const ddsi_sertype& type, const detail::Envelope& envelope) const;

  struct Received {
    std::shared_ptr<const void> message;  ///< null unless it was asked for
    std::int64_t stamp_ns = 0;            ///< since 1970; 0: the type has none, or nobody looked
    bool stamped = false;                 ///< the type has one
    std::uint64_t sequence = 0;
  };
  /// Nullopt: the bytes are no message of this topic.
  [[nodiscard]] std::optional<Received> decode(std::span<const std::byte> bytes,
                                               bool with_message) const;

 private:
  [[nodiscard]] bool native() const { return !spec_.ros_type.empty(); }
  /// Of the message alone.
  [[nodiscard]] std::size_t largest() const;
  const detail::TopicSpec spec_;
  const std::shared_ptr<KeptMessages> kept_ = std::make_shared<KeptMessages>();
};

}  // namespace xauto::transport

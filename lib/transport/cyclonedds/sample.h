// SPDX-License-Identifier: Apache-2.0
// Messages as Cyclone DDS carries them between its wire and us: bytes, of whatever type. Cyclone's
// generated types would have every message as a C struct in between, which is a copy more.
//
// This is Cyclone's interface for other languages' types (dds_create_topic_sertype), not the DDS
// standard's; rmw_cyclonedds, through which ROS 2 speaks, stands on the same.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>

namespace xauto::transport {

/// How many messages of a topic went before anybody took them: newer ones came, and one waits. Cyclone
/// does not count them. It is shared with them, since Cyclone may keep some longer than we.
using Replaced = std::shared_ptr<std::atomic<std::uint64_t>>;

/// A message with its encapsulation header, and up to three bytes more: DDS sends multiples of four.
/// Shared, counted by Cyclone; the bytes lie behind it.
struct Sample : ddsi_serdata {
  std::size_t size;   ///< without the bytes that fill it up
  std::size_t room;   ///< of its memory, this header included
  Replaced replaced;  ///< null: it was sent from here
  std::atomic<bool> taken{false};

  [[nodiscard]] std::span<std::byte> bytes() {
    return {reinterpret_cast<std::byte*>(this + 1), size};
  }
  [[nodiscard]] std::span<const std::byte> bytes() const {
    return {reinterpret_cast<const std::byte*>(this + 1), size};
  }
};

struct Unref {
  void operator()(Sample* sample) const { ddsi_serdata_unref(sample); }
};
using SamplePtr = std::unique_ptr<Sample, Unref>;

/// A type without keys of this name, e.g. "sensor_msgs::msg::dds_::Image_". The caller's, until
/// dds_create_topic_sertype takes it; else ddsi_sertype_unref frees it. With `replaced` it is one topic's
/// alone, whose messages count there.
[[nodiscard]] ddsi_sertype* make_type(const std::string& name, Replaced replaced = nullptr);
/// Room for a message of `size` bytes, at least four; null: no memory.
[[nodiscard]] SamplePtr make_sample(const ddsi_sertype& type, std::size_t size);

}  // namespace xauto::transport

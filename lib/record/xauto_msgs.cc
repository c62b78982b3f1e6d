// SPDX-License-Identifier: Apache-2.0
#include "record/xauto_msgs.h"

#include <algorithm>
#include <array>
#include <utility>

#include "record/mcap_format.h"

namespace xauto::record {
namespace {

// As ROS 2 records definitions: the .msg file, then those that it needs behind a line of 80 '='.
#define XAUTO_MSG_TIME                                                                 \
  "\n"                                                                                 \
  "================================================================================\n" \
  "MSG: builtin_interfaces/Time\n"                                                     \
  "int32 sec\n"                                                                        \
  "uint32 nanosec\n"
constexpr const char* kMessageSchema =
    "# A message of an app of XAuto.\n"
    "builtin_interfaces/Time stamp    # when the sensor released it, wall-clock time\n"
    "uint64 number                    # of that release\n"
    "uint8[] data                     # the message: xauto::Codec's bytes\n" XAUTO_MSG_TIME;
constexpr const char* kReleaseSchema =
    "# What became of one release of an app's sensors.\n"
    "builtin_interfaces/Time stamp    # from which latency_us counts, wall-clock time\n"
    "uint64 number                    # as in the Message of the same release\n"
    "int64 latency_us                 # until the last of the app's results; -1: "
    "lost\n" XAUTO_MSG_TIME;
#undef XAUTO_MSG_TIME

/// What CDR begins with: plain, little-endian, no options.
constexpr std::array<std::byte, 4> kCdr = {std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};

/// Numbers are little-endian there, too.
mcap::Bytes begin(std::int64_t stamp_ns, std::uint64_t number, std::size_t more) {
  mcap::Bytes out;
  out.reserve(kCdr.size() + 4 + 4 + 8 + more);
  out.bytes(kCdr);
  out.u32(static_cast<std::uint32_t>(stamp_ns / 1'000'000'000));
  out.u32(static_cast<std::uint32_t>(stamp_ns % 1'000'000'000));
  out.u64(number);
  return out;
}

}  // namespace

Topic app_topic(const std::string& name, const std::string& ros_type, std::string_view schema) {
  Topic topic{name.starts_with('/') ? name : "/" + name, std::string(kMessageType), "cdr",
              "ros2msg", kMessageSchema};
  if (ros_type.empty()) return topic;
  topic.type = ros_type;
  topic.schema = schema;
  return topic;
}

bool is_app_topic(const Topic& recorded, const std::string& name) {
  return recorded.name == name || recorded.name == "/" + name;
}

std::vector<std::byte> enclose(std::int64_t stamp_ns, std::uint64_t number,
                               std::span<const std::byte> data) {
  mcap::Bytes out = begin(stamp_ns, number, 4 + data.size());
  out.sized(data);
  return std::move(out).take();
}

Result<std::span<const std::byte>> enclosed(const Topic& topic,
                                            std::span<const std::byte> message) {
  if (topic.type != kMessageType || topic.serialization_format != "cdr") return message;
  const auto broken = [&](const std::string& what) {
    return fail(ErrorCode::kInvalid, "a message of type " + topic.type + " " + what, topic.name);
  };
  mcap::Cursor in(message);
  const auto begin = in.bytes(kCdr.size());
  // The last two bytes are options, which ROS 2's middlewares use for the padding at the end.
  if (!in.ok() || !std::equal(begin.begin(), begin.begin() + 2, kCdr.begin()))
    return broken("is not in little-endian CDR");
  (void)in.u64();  // stamp
  (void)in.u64();  // number
  const auto data = in.sized();
  if (!in.ok()) return broken("is shorter than it says");
  return data;
}

Topic releases_topic() {
  return {"/xauto/releases", "xauto_msgs/msg/Release", "cdr", "ros2msg", kReleaseSchema};
}

std::vector<std::byte> encode_release(std::int64_t stamp_ns, std::uint64_t number,
                                      std::int64_t latency_us) {
  mcap::Bytes out = begin(stamp_ns, number, 8);
  out.u64(static_cast<std::uint64_t>(latency_us));
  return std::move(out).take();
}

}  // namespace xauto::record

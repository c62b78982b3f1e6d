// SPDX-License-Identifier: Apache-2.0
#include "record/xauto_msgs.h"

#include <algorithm>
#include <array>
#include <utility>

#include "record/mcap_format.h"

namespace xauto::record {
namespace {

// As ROS 2 records definitions: the .msg file, then those that it needs behind a line of 80 '='.
constexpr const char* kMessageSchema =
    "# A message of an app of XAuto.\n"
    "builtin_interfaces/Time stamp    # when the sensor released it, wall-clock time\n"
    "uint64 number                    # of that release\n"
    "uint8[] data                     # the message: xauto::Codec's bytes\n"
    "\n"
    "================================================================================\n"
    "MSG: builtin_interfaces/Time\n"
    "int32 sec\n"
    "uint32 nanosec\n";

/// What CDR begins with: plain, little-endian, no options.
constexpr std::array<std::byte, 4> kCdr = {std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}};

}  // namespace

Topic app_topic(const std::string& name) {
  return {name.starts_with('/') ? name : "/" + name, std::string(kMessageType), "cdr", "ros2msg",
          kMessageSchema};
}

bool is_app_topic(const Topic& recorded, const std::string& name) {
  return recorded.name == name || recorded.name == "/" + name;
}

std::vector<std::byte> enclose(std::int64_t stamp_ns, std::uint64_t number,
                               std::span<const std::byte> data) {
  mcap::Bytes out;  // numbers are little-endian there, too
  out.reserve(kCdr.size() + 4 + 4 + 8 + 4 + data.size());
  out.bytes(kCdr);
  out.u32(static_cast<std::uint32_t>(stamp_ns / 1'000'000'000));
  out.u32(static_cast<std::uint32_t>(stamp_ns % 1'000'000'000));
  out.u64(number);
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

}  // namespace xauto::record

// SPDX-License-Identifier: Apache-2.0
// What ros2_relay makes of a String, an Image or a PointCloud2, and what ros2_peer expects of it: the types are
// XAuto's in the one, ROS 2's in the other, and their members are the same.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <utility>

/// The number that a message is known by: a String's first word, or the header's frame.
template <class Message>
std::uint32_t number_of(const Message& message) {
  if constexpr (requires { message.header; })
    return static_cast<std::uint32_t>(std::atoll(message.header.frame_id.c_str()));
  else
    return static_cast<std::uint32_t>(std::atoll(message.data.c_str()));
}
inline std::int64_t wall_ns() {
  return std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count();
}
/// Since the header's stamp; 0 where there is none.
template <class Message>
std::int64_t age_ns(const Message& message) {
  if constexpr (requires { message.header; })
    return wall_ns() - message.header.stamp.sec * std::int64_t{1'000'000'000} -
           message.header.stamp.nanosec;
  else
    return 0;
}
template <class Message>
void name(Message& message, std::uint64_t number) {
  if constexpr (requires { message.header; }) {
    const std::int64_t now = wall_ns();
    message.header.stamp.sec = static_cast<std::int32_t>(now / 1'000'000'000);
    message.header.stamp.nanosec = static_cast<std::uint32_t>(now % 1'000'000'000);
    message.header.frame_id = std::to_string(number);
  } else {
    message.data = std::to_string(number) + ' ';
  }
}

template <class Message>
void change(Message& message) {
  if constexpr (!requires { message.header; }) {
    message.data += "!";
  } else {
    std::swap(message.height, message.width);
    if constexpr (requires { message.encoding; }) {
      message.step += 1;
      message.is_bigendian ^= 1;
      message.encoding += "!";
    } else {
      std::swap(message.point_step, message.row_step);
      message.is_dense = !message.is_dense;
      for (auto& field : message.fields) std::swap(field.offset, field.count);
    }
    message.header.stamp.nanosec ^= 1;
    if (!message.data.empty()) message.data.back() ^= 0xff;
  }
}

// SPDX-License-Identifier: Apache-2.0
// What ros2_relay makes of a String, an Image or a PointCloud2, and what ros2_peer expects of it: the types are
// XAuto's in the one, ROS 2's in the other, and their members are the same.
#pragma once

#include <utility>

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

// SPDX-License-Identifier: Apache-2.0
// The type of std_msgs/msg/Int32.msg, for nodes beside the stand-in of rclcpp.
#pragma once

#include <cstdint>

namespace std_msgs::msg {
struct Int32 {
  std::int32_t data = 0;
};
}  // namespace std_msgs::msg

// SPDX-License-Identifier: Apache-2.0
// The same tests, with the stand-in as Jazzy behaves: two programs, since both define rclcpp's classes.
#define RCLCPP_STAND_IN_JAZZY
#include "../ros2/gate_test.cc"  // NOLINT(bugprone-suspicious-include)

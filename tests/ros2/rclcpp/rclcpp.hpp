// SPDX-License-Identifier: Apache-2.0
// A stand-in of the few types of rclcpp that xauto/ros2.h and an ordinary node touch. Never installed. Written from
// rclcpp's sources, tags 16.0.11 (Humble) and 28.1.6 (Jazzy); each behaviour names the file that has it, below
// rclcpp/src/rclcpp/ unless it says otherwise. With RCLCPP_STAND_IN_JAZZY it behaves as Jazzy where the two differ.
//
// Not here: services, clients, waitables, intra-process messages, QoS but depth, and DDS. What is published arrives
// at once, in this process. One lock for all of a context's queues, instead of rcl's and the middleware's. The tests
// that use it run with rclcpp itself, too, where there is one: XAUTO_RCLCPP in tests/CMakeLists.txt.
#pragma once

#include <rclcpp/executor.hpp>
#include <rclcpp/node.hpp>

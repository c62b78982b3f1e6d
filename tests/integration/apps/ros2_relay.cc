// SPDX-License-Identifier: Apache-2.0
// An app between topics of ROS 2, by the types of xauto_add_messages:
//
//   ros2_relay String|Image|PointCloud2 [FILE [PERIOD_MS]]
//
// What comes on "there" goes out on "back", changed in a way that shows which field was taken for which. FILE gets a
// line per message: NUMBER LATENCY_NS, from the header's stamp until the job has the message.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <utility>

#include <sensor_msgs/msg/image.h>
#include <sensor_msgs/msg/point_cloud2.h>
#include <std_msgs/msg/string.h>

#include <xauto/xauto.h>

#include "ros2_change.h"

namespace {

using namespace std::chrono_literals;
using sensor_msgs::msg::Image;
using sensor_msgs::msg::PointCloud2;
using std_msgs::msg::String;

template <class Message>
int relay(int argc, char** argv) {
  struct State {
    Message message;
  };
  const xauto::Topic<Message> there("there"), back("back");
  std::ofstream file;
  if (argc > 2) file.open(argv[2]);
  xauto::XNode<State> node("relay.change");
  node.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [&](State& state, const xauto::Input& input) {
        const Message& message = input.get(there);
        if constexpr (requires { message.header; }) {
          const auto now = std::chrono::system_clock::now().time_since_epoch();
          const std::chrono::nanoseconds stamp =
              std::chrono::seconds(message.header.stamp.sec) +
              std::chrono::nanoseconds(message.header.stamp.nanosec);
          file << message.header.frame_id << ' ' << (now - stamp) / 1ns << '\n';
        }
        state.message = message;
        change(state.message);
      });
  xauto::XModule<State> module("relay");
  module.add_node(node).add_input_topic(there).add_output_topic(back, &State::message);
  xauto::App app("ros2_relay");
  const std::chrono::milliseconds period(argc > 3 ? std::atoll(argv[3]) : 20);
  app.add_source(there, period, [](std::uint64_t) { return Message{}; });
  app.add_module(module);
  return app.main(argc, argv);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string type = argc > 1 ? argv[1] : "";
  if (type == "String") return relay<String>(argc, argv);
  if (type == "Image") return relay<Image>(argc, argv);
  if (type == "PointCloud2") return relay<PointCloud2>(argc, argv);
  std::fprintf(stderr,
               "usage: xauto run ... -- ros2_relay String|Image|PointCloud2 [FILE [PERIOD_MS]]\n");
  return 2;
}

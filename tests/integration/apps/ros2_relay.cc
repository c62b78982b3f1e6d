// SPDX-License-Identifier: Apache-2.0
// An app between topics of ROS 2, by the types of xauto_add_messages:
//
//   ros2_relay String|Image|PointCloud2 [FILE [PERIOD_MS [BYTES]]]
//
// What comes on "there" goes out on "back", changed in a way that shows which field was taken for which. FILE gets a
// line per message: NUMBER LATENCY_NS TAKEN_NS, from the header's stamp until the job has the message, and when that
// is, by the wall clock. Where nothing feeds it, its source makes numbered messages of BYTES: for recordings.
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include <sensor_msgs/msg/image.h>
#include <sensor_msgs/msg/point_cloud2.h>
#include <std_msgs/msg/string.h>

#include <xauto/xauto.h>

#include "ros2_change.h"

namespace {

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
        file << number_of(message) << ' ' << age_ns(message) << ' ' << wall_ns() << std::endl;
        state.message = message;
        change(state.message);
      });
  xauto::XModule<State> module("relay");
  module.add_node(node).add_input_topic(there).add_output_topic(back, &State::message);
  xauto::App app("ros2_relay");
  const std::chrono::microseconds period(
      static_cast<std::int64_t>((argc > 3 ? std::atof(argv[3]) : 20) * 1000));
  const auto bytes = static_cast<std::size_t>(argc > 4 ? std::atoll(argv[4]) : 0);
  app.add_source(there, period, [bytes](std::uint64_t number) {
    Message message;
    name(message, number);
    message.data.resize(message.data.size() + bytes, 'x');
    return message;
  });
  app.add_module(module);
  return app.main(argc, argv);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string type = argc > 1 ? argv[1] : "";
  if (type == "String") return relay<String>(argc, argv);
  if (type == "Image") return relay<Image>(argc, argv);
  if (type == "PointCloud2") return relay<PointCloud2>(argc, argv);
  std::fprintf(
      stderr,
      "usage: xauto run ... -- ros2_relay String|Image|PointCloud2 [FILE [PERIOD_MS [BYTES]]]\n");
  return 2;
}

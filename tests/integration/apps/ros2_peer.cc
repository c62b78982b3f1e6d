// SPDX-License-Identifier: Apache-2.0
// A program of rclcpp alone, beside ros2_relay:
//
//   ros2_peer trip String|Image|PointCloud2 RELIABILITY DURABILITY BYTES COUNT
//     sends on /there until COUNT messages came back on /back; each of them must be the one sent, changed as
//     ros2_relay does. Status 1: one was not, and which.
//   ros2_peer turns BYTES COUNT PERIOD_MS     sends images in turns on /there and /here, stamped
//   ros2_peer hear FILE COUNT                 hears /here: NUMBER LATENCY_NS, from the stamp until the callback has it
//   ros2_peer talk String|Image RELIABILITY DEPTH BYTES COUNT PERIOD_US READERS
//     sends numbered messages on /there, once so many hear it
//   ros2_peer listen String|Image TOPIC RELIABILITY DEPTH FILE
//     hears TOPIC until SIGINT: NUMBER LATENCY_NS TAKEN_NS, the last by the wall clock
//
// RELIABILITY: reliable, best_effort. DURABILITY: volatile, transient_local.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>

#include "ros2_change.h"

namespace {

using namespace std::chrono_literals;
using sensor_msgs::msg::Image;
using sensor_msgs::msg::PointCloud2;
using std_msgs::msg::String;

/// Bytes that differ by message and by place.
std::vector<std::uint8_t> filled(std::size_t bytes, std::uint32_t number) {
  std::vector<std::uint8_t> data(bytes);
  for (std::size_t i = 0; i < bytes; ++i)
    data[i] = static_cast<std::uint8_t>((i * 2654435761u >> 13) + number);
  return data;
}
void fill(String& message, std::uint32_t number, std::size_t bytes) {
  name(message, number);
  message.data += "Grüße " + std::string(bytes, 'x');
}
void fill(Image& message, std::uint32_t number, std::size_t bytes) {
  name(message, number);
  message.height = 3 + number;
  message.width = 1000 + number;
  message.encoding = "rgb8";
  message.is_bigendian = number & 1;
  message.step = 77 + number;
  message.data = filled(bytes, number);
}
void fill(PointCloud2& message, std::uint32_t number, std::size_t bytes) {
  name(message, number);
  message.height = 1;
  message.width = 1000 + number;
  for (const char* name : {"x", "y", "z", "intensity"}) {
    sensor_msgs::msg::PointField field;
    field.name = name;
    field.offset = static_cast<std::uint32_t>(4 * message.fields.size());
    field.datatype = sensor_msgs::msg::PointField::FLOAT32;
    field.count = 1;
    message.fields.push_back(field);
  }
  message.is_bigendian = false;
  message.point_step = 16;
  message.row_step = 16 * message.width;
  message.is_dense = number % 3 == 0;
  message.data = filled(bytes, number);
}

rclcpp::QoS qos(const std::string& reliability, const std::string& durability,
                std::size_t depth = 4) {
  rclcpp::QoS made{rclcpp::KeepLast(depth)};
  if (reliability == "best_effort")
    made.best_effort();
  else
    made.reliable();
  if (durability == "transient_local") made.transient_local();
  return made;
}

template <class Message>
int trip(const rclcpp::QoS& with, std::size_t bytes, std::size_t count) {
  const auto node = std::make_shared<rclcpp::Node>("peer");
  const auto out = node->create_publisher<Message>("there", with);
  std::map<std::uint32_t, Message> sent;
  std::map<std::uint32_t, int> came;
  int wrong = 0;
  const auto in = node->create_subscription<Message>("back", with, [&](const Message& message) {
    const std::uint32_t number = number_of(message);
    const auto expected = sent.find(number);
    if (expected == sent.end() || expected->second != message || ++came[number] > 1) {
      std::printf("%u came back wrong\n", number);
      ++wrong;
    }
  });
  std::uint32_t number = 0;
  const auto timer = node->create_wall_timer(40ms, [&] {
    Message message;
    fill(message, ++number, bytes);
    out->publish(message);
    change(message);
    sent.emplace(number, std::move(message));
    sent.erase(number - 50);
  });
  while (rclcpp::ok() && came.size() < count && wrong == 0) rclcpp::spin_some(node);
  std::printf("%zu of %u came back\n", came.size(), number);
  return wrong == 0 ? 0 : 1;
}

int turns(std::size_t bytes, std::uint32_t count, std::chrono::milliseconds period) {
  const auto node = std::make_shared<rclcpp::Node>("talker");
  const auto with = rclcpp::QoS(rclcpp::KeepLast(1)).reliable();
  const rclcpp::Publisher<Image>::SharedPtr out[] = {node->create_publisher<Image>("there", with),
                                                     node->create_publisher<Image>("here", with)};
  while (out[0]->get_subscription_count() == 0 || out[1]->get_subscription_count() == 0)
    rclcpp::sleep_for(10ms);
  Image message;
  fill(message, 0, bytes);
  for (std::uint32_t k = 0; k < 2 * count && rclcpp::ok(); ++k) {
    rclcpp::sleep_for(period);
    name(message, k);
    out[k % 2]->publish(message);
  }
  rclcpp::sleep_for(500ms);
  return 0;
}

int hear(const std::string& path, std::size_t count) {
  const auto node = std::make_shared<rclcpp::Node>("hearer");
  std::ofstream file(path);
  std::size_t came = 0;
  const auto in = node->create_subscription<Image>(
      "here", rclcpp::QoS(rclcpp::KeepLast(1)).reliable(), [&](const Image& message) {
        file << number_of(message) << ' ' << age_ns(message) << std::endl;
        if (++came == count) rclcpp::shutdown();
      });
  rclcpp::spin(node);
  return 0;
}

/// `readers`: begins when so many hear it.
template <class Message>
int talk(const rclcpp::QoS& with, std::size_t bytes, std::uint32_t count,
         std::chrono::microseconds period, std::size_t readers) {
  const auto node = std::make_shared<rclcpp::Node>("talker");
  const auto out = node->create_publisher<Message>("there", with);
  while (rclcpp::ok() && out->get_subscription_count() < readers) rclcpp::sleep_for(10ms);
  Message message;
  fill(message, 0, bytes);
  auto due = std::chrono::steady_clock::now() + 200ms;
  for (std::uint32_t k = 0; k < count && rclcpp::ok(); ++k, due += period) {
    std::this_thread::sleep_until(due);
    if constexpr (requires { message.header; })
      name(message, k);  // and the rest as it is: to make it takes longer than to send it
    else
      fill(message, k, bytes);
    out->publish(message);
  }
  rclcpp::sleep_for(500ms);
  return 0;
}

template <class Message>
int listen(const std::string& topic, const rclcpp::QoS& with, const std::string& path) {
  const auto node = std::make_shared<rclcpp::Node>("listener");
  std::ofstream file(path);
  const auto in = node->create_subscription<Message>(topic, with, [&](const Message& message) {
    file << number_of(message) << ' ' << age_ns(message) << ' ' << wall_ns() << std::endl;
  });
  rclcpp::spin(node);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  const std::string verb = argc > 1 ? argv[1] : "", type = argc > 2 ? argv[2] : "";
  const auto number = [&](int at) { return static_cast<std::size_t>(std::atoll(argv[at])); };
  if (verb == "trip" && argc == 7) {
    const rclcpp::QoS with = qos(argv[3], argv[4]);
    if (type == "String") return trip<String>(with, number(5), number(6));
    if (type == "Image") return trip<Image>(with, number(5), number(6));
    if (type == "PointCloud2") return trip<PointCloud2>(with, number(5), number(6));
  }
  if (verb == "talk" && argc == 9) {
    const rclcpp::QoS with = qos(argv[3], "volatile", number(4));
    const std::chrono::microseconds period(std::atoll(argv[7]));
    const auto count = static_cast<std::uint32_t>(number(6));
    if (type == "String") return talk<String>(with, number(5), count, period, number(8));
    if (type == "Image") return talk<Image>(with, number(5), count, period, number(8));
  }
  if (verb == "listen" && argc == 7) {
    const rclcpp::QoS with = qos(argv[4], "volatile", number(5));
    if (type == "String") return listen<String>(argv[3], with, argv[6]);
    if (type == "Image") return listen<Image>(argv[3], with, argv[6]);
  }
  if (verb == "turns" && argc == 5)
    return turns(number(2), static_cast<std::uint32_t>(number(3)),
                 std::chrono::milliseconds(number(4)));
  if (verb == "hear" && argc == 4) return hear(argv[2], number(3));
  std::fprintf(stderr, "usage: see the head of ros2_peer.cc\n");
  return 2;
}

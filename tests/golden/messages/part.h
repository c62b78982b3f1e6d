// Made of test_msgs/msg/Part.msg by XAuto's tools/messages.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/cdr.h>

namespace test_msgs::msg {

struct Part {
  std::uint8_t first{};
  double second{};
  std::string third{};

  bool operator==(const Part&) const = default;
};

}  // namespace test_msgs::msg

template <>
struct xauto::Interface<test_msgs::msg::Part> {
  static constexpr const char* kName = "test_msgs/msg/Part";
  static constexpr const char* kSchema =
      "uint8 first\n"
      "float64 second\n"
      "string third\n";
  template <class Message, class Visit>
  static void fields(Message& m, Visit&& visit) {
    visit(m.first);
    visit(m.second);
    visit(m.third);
  }
};
template <>
struct xauto::Codec<test_msgs::msg::Part> : xauto::cdr::MessageCodec<test_msgs::msg::Part> {
};

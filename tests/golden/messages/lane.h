// Made of test_msgs/msg/Lane.idl by XAuto's tools/messages.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/cdr.h>

#include <std_msgs/msg/header.h>
#include <test_msgs/msg/part.h>

namespace test_msgs::msg {

struct Lane {
  static constexpr std::uint8_t SOLID = 1;
  static constexpr std::int32_t FARTHEST = -16;
  static constexpr std::string_view LEFT{"left", 4};
  ::std_msgs::msg::Header header{};
  std::array<double, 3> coefficients{};
  float width{2.5F};
  bool seen{true};
  bool sure{true};
  std::vector<::test_msgs::msg::Part> parts{};
  std::vector<std::string> marks{};
  std::uint64_t stamp{};
  std::array<std::uint16_t, 4> kinds{};
  std::vector<std::int16_t> order{1, 2};

  bool operator==(const Lane&) const = default;
};

}  // namespace test_msgs::msg

template <>
struct xauto::Interface<test_msgs::msg::Lane> {
  static constexpr const char* kName = "test_msgs/msg/Lane";
  static constexpr const char* kSchema =
      "byte SOLID=1\n"
      "int32 FARTHEST=-16\n"
      "string LEFT=\042left\042\n"
      "std_msgs/Header header\n"
      "float64[3] coefficients\n"
      "float32 width 2.5\n"
      "bool seen true\n"
      "bool sure true\n"
      "Part[<=4] parts\n"
      "string<=3[] marks\n"
      "uint64 stamp\n"
      "uint16[4] kinds\n"
      "int16[] order [1, 2]\n"
      "================================================================================\n"
      "MSG: builtin_interfaces/Time\n"
      "int32 sec\n"
      "uint32 nanosec\n"
      "================================================================================\n"
      "MSG: std_msgs/Header\n"
      "builtin_interfaces/Time stamp\n"
      "string frame_id\n"
      "================================================================================\n"
      "MSG: test_msgs/Part\n"
      "uint8 first\n"
      "float64 second\n"
      "string third\n";
  template <class Message, class Visit>
  static void fields(Message& m, Visit&& visit) {
    visit(m.header);
    visit(m.coefficients);
    visit(m.width);
    visit(m.seen);
    visit(m.sure);
    visit(m.parts, 4U);
    visit(m.marks, xauto::cdr::kUnbounded, 3U);
    visit(m.stamp);
    visit(m.kinds);
    visit(m.order);
  }
  static std::int64_t stamp_ns(const test_msgs::msg::Lane& m) {
    return std::int64_t{m.header.stamp.sec} * 1'000'000'000 + m.header.stamp.nanosec;
  }
};
template <>
struct xauto::Codec<test_msgs::msg::Lane> : xauto::cdr::MessageCodec<test_msgs::msg::Lane> {
};

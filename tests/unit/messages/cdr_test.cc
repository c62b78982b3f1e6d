// SPDX-License-Identifier: Apache-2.0
// CDR by the rules of the standard (OMG XTypes 1.3, 7.4.1), written out by hand; what must be refused.
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sensor_msgs/msg/image.h>
#include <std_msgs/msg/bool.h>
#include <std_msgs/msg/empty.h>
#include <test_msgs/msg/all_kinds.h>
#include <test_msgs/msg/lane.h>
#include <test_msgs/msg/wide.h>

#include <xauto/cdr.h>

#include "model/message.h"

#include "filled.h"

namespace xauto {
namespace {

using test_msgs::msg::AllKinds;
using test_msgs::msg::Lane;
using test_msgs::msg::Part;
using test_msgs::msg::Wide;

std::vector<std::byte> bytes(const std::vector<int>& values) {
  std::vector<std::byte> out;
  for (const int value : values) out.push_back(static_cast<std::byte>(value));
  return out;
}

const Part kPart{7, 1.0, "ab"};
// An octet, 7 bytes of padding, a double, the text's length with its end, the text.
const std::vector<int> kPartLittle = {0, 1, 0, 0, 7,    0,    0, 0, 0, 0, 0,   0,   0, 0,
                                      0, 0, 0, 0, 0xf0, 0x3f, 3, 0, 0, 0, 'a', 'b', 0};
const std::vector<int> kPartBig = {0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0,   0,   0x3f, 0xf0,
                                   0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 'a', 'b', 0};

TEST(Cdr, IsWrittenLittleEndianAndAligned) {
  EXPECT_EQ(Codec<Part>::encode(kPart), bytes(kPartLittle));
  EXPECT_EQ(Codec<std_msgs::msg::Empty>::encode({}), bytes({0, 1, 0, 0, 0}));
}

TEST(Cdr, BothByteOrdersAreRead) {
  EXPECT_EQ(Codec<Part>::decode(bytes(kPartLittle)), kPart);
  EXPECT_EQ(Codec<Part>::decode(bytes(kPartBig)), kPart);
}

TEST(Cdr, EmptySequenceOfDoublesIsNotAligned) {
  Lane lane;
  const std::size_t empty = Codec<Lane>::encoded_bytes(lane);
  lane.parts.resize(1);
  EXPECT_EQ(Codec<Lane>::encode(lane).size(), Codec<Lane>::encoded_bytes(lane));
  EXPECT_GT(Codec<Lane>::encoded_bytes(lane), empty);
}

TEST(Cdr, WideTextIsAsRos2sCycloneWritesIt) {
  Wide wide;
  wide.text = u"a\u20ac";
  EXPECT_EQ(Codec<Wide>::encode(wide),
            bytes({0, 1, 0, 0, 2, 0, 0, 0, 'a', 0, 0, 0, 0xac, 0x20, 0, 0, 0, 0, 0, 0}));
  EXPECT_EQ(Codec<Wide>::decode(Codec<Wide>::encode(wide)), wide);
}

TEST(Cdr, WhatIsEncodedIsDecoded) {
  for (unsigned seed = 0; seed < 200; ++seed) {
    const auto all = test::filled<AllKinds>(seed);
    EXPECT_EQ(Codec<AllKinds>::decode(Codec<AllKinds>::encode(all)), all);
    const auto wide = test::filled<Wide>(seed);
    EXPECT_EQ(Codec<Wide>::decode(Codec<Wide>::encode(wide)), wide);
    const auto lane = test::filled<Lane>(seed);
    EXPECT_EQ(Codec<Lane>::decode(Codec<Lane>::encode(lane)), lane);
  }
}

TEST(Cdr, MessageThatIsCutIsRefused) {
  const auto all = Codec<AllKinds>::encode(test::filled<AllKinds>(3));
  for (std::size_t size = 0; size < all.size(); ++size)
    EXPECT_THROW((void)Codec<AllKinds>::decode({all.data(), size}), std::runtime_error) << size;
}

TEST(Cdr, UpToThreeBytesMayFollow) {
  auto part = bytes(kPartLittle);
  part.resize(part.size() + 3);
  EXPECT_EQ(Codec<Part>::decode(part), kPart);
  part.resize(part.size() + 1);
  EXPECT_THROW((void)Codec<Part>::decode(part), std::runtime_error);
}

TEST(Cdr, WhatIsNoPlainCdrIsRefused) {
  for (const int first : {1, 0xff})
    EXPECT_THROW((void)Codec<std_msgs::msg::Bool>::decode(bytes({first, 1, 0, 0, 1})),
                 std::runtime_error);
  for (const int kind : {2, 3, 6, 7, 9})  // parameter lists, and version 2 of the encoding
    EXPECT_THROW((void)Codec<std_msgs::msg::Bool>::decode(bytes({0, kind, 0, 0, 1})),
                 std::runtime_error);
  EXPECT_THROW((void)Codec<std_msgs::msg::Bool>::decode(bytes({0, 1, 0, 0, 2})),
               std::runtime_error);
  EXPECT_THROW((void)Codec<Part>::decode(bytes(
                   {0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 'a'})),
               std::runtime_error);  // a text without its end
}

TEST(Cdr, SequenceThatClaimsMoreThanThereIsIsRefusedBeforeItIsMade) {
  auto image = Codec<sensor_msgs::msg::Image>::encode({});
  for (std::size_t i = image.size() - 4; i < image.size(); ++i) image[i] = std::byte{0xff};
  EXPECT_THROW((void)Codec<sensor_msgs::msg::Image>::decode(image), std::runtime_error);
}

TEST(Cdr, BoundsHoldBothWays) {
  AllKinds all;
  all.a_short_string = "12345678";
  EXPECT_THROW((void)Codec<AllKinds>::encode(all), std::length_error);
  all = {};
  all.at_most_four.resize(5);
  EXPECT_THROW((void)Codec<AllKinds>::encode(all), std::length_error);
  all = {};
  all.short_texts = {"12345", "123456"};
  EXPECT_THROW((void)Codec<AllKinds>::encode(all), std::length_error);
  Wide wide;
  wide.short_texts = {u"ab"};
  auto encoded = Codec<Wide>::encode(wide);
  encoded[12] = std::byte{3};  // its length
  encoded.resize(encoded.size() + 4);
  EXPECT_THROW((void)Codec<Wide>::decode(encoded), std::runtime_error);
}

TEST(Cdr, DefaultsAndConstantsAreThoseOfTheFile) {
  const AllKinds all;
  EXPECT_EQ(all.a_uint16, 65535);
  EXPECT_EQ(all.an_int64, INT64_MIN);
  EXPECT_EQ(all.at_most_four, (std::vector<float>{1.5F, 2.5F}));
  EXPECT_EQ(all.a_string, "caf\xc3\xa9");
  EXPECT_EQ(AllKinds::QUOTED, "a # is no comment here");
  EXPECT_EQ(AllKinds::LARGEST, UINT64_MAX);
  EXPECT_EQ(Lane::FARTHEST, -16);
  EXPECT_EQ((Lane{}.order), (std::vector<std::int16_t>{1, 2}));
}

TEST(Cdr, TopicKnowsNameSchemaAndStamp) {
  const auto spec = detail::topic_spec(Topic<sensor_msgs::msg::Image>("image"));
  EXPECT_EQ(spec->ros_type, "sensor_msgs/msg/Image");
  EXPECT_EQ(spec->schema.substr(0, 31), "std_msgs/Header header\nuint32 h");
  EXPECT_NE(spec->schema.find("\n" + std::string(80, '=') + "\nMSG: builtin_interfaces/Time\n"),
            std::string::npos);
  sensor_msgs::msg::Image image;
  image.header.stamp.sec = 3;
  image.header.stamp.nanosec = 5;
  ASSERT_NE(spec->stamp_ns, nullptr);
  EXPECT_EQ(spec->stamp_ns(&image), 3'000'000'005);
  EXPECT_EQ(detail::topic_spec(Topic<Part>("part"))->stamp_ns, nullptr);
  EXPECT_TRUE(detail::topic_spec(Topic<std::string>("text"))->ros_type.empty());
}

}  // namespace
}  // namespace xauto

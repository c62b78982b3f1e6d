// SPDX-License-Identifier: Apache-2.0
#include "transport/kept_messages.h"

#include <cstring>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/topic.h>

namespace xauto {
namespace {

struct Picture {
  std::vector<unsigned char> pixels;
  std::string name;
};

}  // namespace

/// Pixels, but for the last byte, which is the name. A first byte of 255 is no picture.
template <>
struct Codec<Picture> {
  static constexpr bool kAvailable = true;
  static std::vector<std::byte> encode(const Picture&) { return {}; }
  static void decode_into(Picture& picture, std::span<const std::byte> b) {
    const auto* from = reinterpret_cast<const unsigned char*>(b.data());
    picture.pixels.assign(from, from + b.size() - 1);
    if (picture.pixels.front() == 255) throw std::runtime_error("no picture");
    picture.name.assign(1, static_cast<char>(b.back()));
  }
};

namespace transport {
namespace {

class Kept : public ::testing::Test {
 protected:
  std::shared_ptr<const Picture> decode(std::size_t size, unsigned char value) {
    std::vector<std::byte> bytes(size, std::byte{value});
    return std::static_pointer_cast<const Picture>(kept_->decode(*spec_, bytes));
  }
  const detail::TopicHandle spec_ = detail::topic_spec(Topic<Picture>("picture"));
  std::shared_ptr<KeptMessages> kept_ = std::make_shared<KeptMessages>();
};

TEST_F(Kept, WhatNobodyHasIsUsedAgain) {
  auto first = decode(1'000'000, 1);
  const Picture* const at = first.get();
  const unsigned char* const pixels = first->pixels.data();
  const auto copy = first;
  auto second = decode(1'000'000, 2);
  EXPECT_NE(second.get(), at) << "somebody has the first one";
  first.reset();
  EXPECT_EQ(copy->pixels.back(), 1);
  EXPECT_NE(decode(100'000, 3).get(), at);
  const_cast<std::shared_ptr<const Picture>&>(copy).reset();
  second.reset();
  bool again = false;
  std::vector<std::shared_ptr<const Picture>> all;
  for (int k = 0; k < 3; ++k) all.push_back(decode(100'000, 4));
  for (const auto& picture : all) {
    EXPECT_EQ(picture->pixels, std::vector<unsigned char>(99'999, 4)) << "nothing of the old one";
    EXPECT_EQ(picture->name, "\4");
    again |= picture.get() == at && picture->pixels.data() == pixels;
  }
  EXPECT_TRUE(again);
}

TEST_F(Kept, WhatIsNoMessageTakesNothingAway) {
  EXPECT_EQ(decode(200'000, 1)->pixels.size(), 199'999u);
  EXPECT_THROW(decode(200'000, 255), std::runtime_error);
  EXPECT_EQ(decode(200'000, 2)->pixels.back(), 2);
}

TEST_F(Kept, SmallOnesAreNotKept) {
  auto small = decode(100, 1);
  auto large = decode(KeptMessages::kLeastBytes, 1);
  const Picture* const at = large.get();
  small.reset();
  large.reset();
  EXPECT_EQ(decode(KeptMessages::kLeastBytes, 2).get(), at);
}

TEST_F(Kept, MessagesOutliveTheTopicAndMayEndAnywhere) {
  std::vector<std::shared_ptr<const Picture>> all;
  for (unsigned char k = 0; k < 20; ++k) all.push_back(decode(70'000, k));
  kept_.reset();
  std::thread other([rest = std::vector(all.begin() + 10, all.end())]() mutable { rest.clear(); });
  for (unsigned char k = 0; k < 20; ++k) EXPECT_EQ(all[k]->pixels.front(), k);
  all.clear();
  other.join();
}

TEST_F(Kept, OneThreadDecodesWhileAnotherLetsGo) {
  std::vector<std::shared_ptr<const Picture>> ring(3);
  PiMutex mutex;
  std::thread other([&] {
    for (int k = 0; k < 2000; ++k) {
      std::shared_ptr<const Picture> mine;
      {
        const Guard lock(mutex);
        mine = std::move(ring[static_cast<std::size_t>(k) % 3]);
      }
      if (mine == nullptr) continue;
      EXPECT_EQ(mine->pixels.front(), mine->pixels.back());
    }
  });
  for (int k = 0; k < 500; ++k) {
    auto message = decode(KeptMessages::kLeastBytes, static_cast<unsigned char>(k % 255));
    const Guard lock(mutex);
    ring[static_cast<std::size_t>(k) % 3] = std::move(message);
  }
  other.join();
}

}  // namespace
}  // namespace transport
}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
#include "record/background.h"

#include <csignal>
#include <cstring>
#include <filesystem>

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include "record/xauto_msgs.h"

#include "../no_more_threads.h"

namespace xauto::record {
namespace {

namespace fs = std::filesystem;
using IfFull = BackgroundRecorder::IfFull;

class BackgroundTest : public testing::Test {
 protected:
  BackgroundTest()
      : path_(fs::temp_directory_path() /
              ("xauto_background." + std::to_string(getpid()) + ".mcap")) {
    fs::remove(path_);
  }
  ~BackgroundTest() override { fs::remove(path_); }
  [[nodiscard]] Recorder recorder() const {
    auto made = Recorder::create(path_.string());
    EXPECT_TRUE(made && made->add_topic(app_topic("camera")));
    return std::move(*made);
  }
  [[nodiscard]] std::unique_ptr<BackgroundRecorder> start(
      std::size_t queue_bytes = BackgroundRecorder::kQueueBytes) const {
    auto started = BackgroundRecorder::start(recorder(), queue_bytes);
    EXPECT_TRUE(started);
    return std::move(*started);
  }
  fs::path path_;
};

TEST_F(BackgroundTest, AllMessagesAreThereInTheirEnvelope) {
  {
    const auto background = start();
    for (std::uint64_t i = 0; i < 500; ++i)
      background->write_enclosed(0, 1'700'000'000'000'000'007 + static_cast<std::int64_t>(i), i,
                                 std::vector<std::byte>(i, std::byte{1}), IfFull::kWait);
    EXPECT_TRUE(background->close());
    EXPECT_TRUE(background->close()) << "once more does nothing";
  }
  auto recording = Recording::open(path_.string());
  ASSERT_TRUE(recording);
  const Topic topic = recording->topics()[0];
  EXPECT_EQ(topic.name, "/camera");
  EXPECT_TRUE(is_app_topic(topic, "camera") && is_app_topic(topic, "/camera"));
  EXPECT_FALSE(is_app_topic(topic, "amera"));
  for (std::size_t i = 0; i < 500; ++i) {
    const auto message = recording->next();
    ASSERT_TRUE(message && *message);
    const auto data = enclosed(topic, (*message)->data);
    ASSERT_TRUE(data);
    EXPECT_EQ(data->size(), i);
  }
}

// What a power cut leaves: nobody closes the file, and no further message comes.
TEST_F(BackgroundTest, OneMessageIsInTheFileWithoutAnotherAndWithoutAnEnd) {
  auto recorder = Recorder::create(path_.string());
  ASSERT_TRUE(recorder && recorder->add_topic(app_topic("camera")));
  const auto background = BackgroundRecorder::start(std::move(*recorder));
  ASSERT_TRUE(background);
  const auto until = [&](auto there) {
    for (int i = 0; i < 6000 && !there(); ++i) usleep(10'000);
    return there();
  };
  // At once, before any message.
  EXPECT_TRUE(until([&] {
    const auto opened = Recording::open(path_.string());
    return !opened && opened.error().what == "has no messages";
  }));
  (*background)->write(0, 1'700'000'000'000'000'000, std::vector<std::byte>(8));
  EXPECT_TRUE(until([&] {
    const auto opened = Recording::open(path_.string());
    return opened && opened->num_messages() == 1;
  }));
  EXPECT_TRUE((*background)->close());
}

// Formal/02-06-51 by hand: a header, then each number at a multiple of its size.
TEST(XautoMsgs, MessageIsCdr) {
  const std::vector<std::byte> data(3, std::byte{0xab});
  const auto made = enclose(0x12345678LL * 1'000'000'000 + 0x3456789, 0x1122334455667788, data);
  const unsigned char expected[] = {0,    1,    0,    0,                             // CDR_LE
                                    0x78, 0x56, 0x34, 0x12,                          // sec
                                    0x89, 0x67, 0x45, 0x03,                          // nanosec
                                    0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11,  // number
                                    3,    0,    0,    0,    0xab, 0xab, 0xab};
  ASSERT_EQ(made.size(), sizeof expected);
  EXPECT_EQ(std::memcmp(made.data(), expected, sizeof expected), 0);
  EXPECT_EQ(enclosed(app_topic("a"), made)->size(), 3u);
  for (std::size_t size = 0; size < made.size(); ++size)
    EXPECT_FALSE(enclosed(app_topic("a"), std::span(made).first(size))) << size;
  auto big_endian = made;
  big_endian[1] = std::byte{0};
  EXPECT_FALSE(enclosed(app_topic("a"), big_endian));
  // What is of another type is the app's to decode, and so are recordings of before.
  EXPECT_EQ(enclosed({"/a", "sensor_msgs/msg/Image", "cdr"}, made)->size(), made.size());
  EXPECT_EQ(enclosed({"a", "Frame", "xauto"}, made)->size(), made.size());
}

TEST(XautoMsgs, ReleaseIsCdr) {
  const auto made = encode_release(7'000'000'009, 5, -1);
  const unsigned char expected[] = {0, 1, 0, 0, 7, 0, 0,   0,   9,   0,   0,   0,   5,   0,
                                    0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255};
  ASSERT_EQ(made.size(), sizeof expected);
  EXPECT_EQ(std::memcmp(made.data(), expected, sizeof expected), 0);
}

// As on a full disk: the first failure ends the recording, and the caller never notices.
TEST_F(BackgroundTest, FailureIsToldAtTheEnd) {
  const auto background = start();
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{64 << 10, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  std::vector<std::byte> noise(1u << 20);
  for (std::size_t i = 0; i < noise.size(); ++i)
    noise[i] = static_cast<std::byte>((i * i * 2654435761u) >> 13);
  for (int i = 0; i < 10; ++i)
    background->write_enclosed(0, i * 2'000'000'000LL, 0, noise, IfFull::kWait);
  const Status closed = background->close();
  setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_FALSE(closed);
  EXPECT_EQ(closed.error().what.find("recording ended early: cannot be written: "), 0u)
      << closed.error().what;
}

// More than the queue holds, faster than any disk: what is missing is counted.
TEST_F(BackgroundTest, WhatHasNoRoomIsCounted) {
  const std::size_t large = 1u << 20;
  const auto background = start(4 * large);
  constexpr int kMessages = 100;
  for (int i = 0; i < kMessages; ++i)
    background->write_enclosed(0, i, static_cast<std::uint64_t>(i), std::vector<std::byte>(large),
                               IfFull::kLose);
  const Status closed = background->close();
  auto recording = Recording::open(path_.string());
  ASSERT_TRUE(recording);
  EXPECT_GE(recording->num_messages(), 4u);
  if (recording->num_messages() == kMessages) {
    EXPECT_TRUE(closed);
  } else {
    ASSERT_FALSE(closed);
    EXPECT_EQ(closed.error().what, std::to_string(kMessages - recording->num_messages()) +
                                       " messages are missing: writing did not keep up");
  }
}

TEST_F(BackgroundTest, WhereThreadsEndItSaysSo) {
  const NoMoreThreads none;
  const auto started = BackgroundRecorder::start(recorder());
  ASSERT_FALSE(started);
  EXPECT_EQ(started.error().what.find("no more threads: "), 0u) << started.error().what;
}

}  // namespace
}  // namespace xauto::record

// SPDX-License-Identifier: Apache-2.0
// MCAP files: ours byte for byte, others' as they may be. That a second implementation reads ours, and
// that we read its, is tests/integration/mcap_test.py and mcap_core_test.py.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>

#include <gtest/gtest.h>
#include <lz4frame.h>
#include <unistd.h>
#include <zstd.h>

#include "record/mcap_file.h"
#include "record/mcap_format.h"
#include "record/recording.h"
#include "record/storage.h"

#include "../golden_cases.h"

namespace xauto::record {
namespace {

namespace fs = std::filesystem;
using mcap::Bytes;
using mcap::Op;

class McapTest : public testing::Test {
 protected:
  McapTest()
      : folder_(fs::temp_directory_path() / ("xauto_mcap_test." + std::to_string(getpid()))) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~McapTest() override { fs::remove_all(folder_); }
  [[nodiscard]] std::string path(const std::string& name = "a.mcap") const {
    return (folder_ / name).string();
  }

  fs::path folder_;
};

/// Bytes that no compressor makes smaller.
std::vector<std::byte> noise(std::size_t size, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::byte> data(size);
  for (std::byte& byte : data) byte = static_cast<std::byte>(random() >> 24);
  return data;
}

using Messages = std::vector<std::pair<std::int64_t, std::string>>;

/// What can be read, and how the reading ends: empty at the end.
std::pair<Messages, std::string> contents(const std::string& path) {
  auto recording = Recording::open(path);
  if (!recording) return {{}, recording.error().what};
  Messages seen;
  for (;;) {
    const auto message = recording->next();
    if (!message) return {seen, message.error().what};
    if (!*message) return {seen, ""};
    const auto& data = (*message)->data;
    seen.emplace_back((*message)->timestamp_ns,
                      std::string(reinterpret_cast<const char*>(data.data()), data.size()));
  }
}

// ---- files made by hand ------------------------------------------------------------------------

Bytes record(Op op, const Bytes& content) {
  Bytes out;
  out.record(op, content);
  return out;
}

/// A type and the topic /a of it, as channel 1.
Bytes topic_a() {
  Bytes out;
  put(out, mcap::Schema{1, "a/msg/A", "ros2msg", "string data\n"});
  put(out, mcap::Channel{1, 1, "/a", "cdr", {}});
  return out;
}

Bytes message(std::uint64_t time, const std::string& data) {
  Bytes content;
  content.u16(1);
  content.u32(0);
  content.u64(time);
  content.u64(time);
  content.bytes(std::as_bytes(std::span(data.data(), data.size())));
  return record(Op::kMessage, content);
}

std::vector<std::byte> pack(const std::string& compression, std::span<const std::byte> data) {
  std::vector<std::byte> packed(data.begin(), data.end());
  if (compression == "lz4") {
    packed.resize(LZ4F_compressFrameBound(data.size(), nullptr));
    packed.resize(
        LZ4F_compressFrame(packed.data(), packed.size(), data.data(), data.size(), nullptr));
  } else if (compression == "zstd") {
    packed.resize(ZSTD_compressBound(data.size()));
    packed.resize(ZSTD_compress(packed.data(), packed.size(), data.data(), data.size(), 3));
  }
  return packed;
}

Bytes chunk(std::uint64_t start, std::uint64_t end, const Bytes& records,
            const std::string& compression = "") {
  const auto packed = pack(compression, records.view());
  Bytes out;
  put(out, mcap::ChunkHead{start, end, records.size(), mcap::crc32(records.view()), compression,
                           packed.size()});
  out.bytes(packed);
  return out;
}

Bytes operator+(Bytes a, const Bytes& b) {
  a.bytes(b.view());
  return a;
}

/// Magic and Header, `data`, and an end without a summary.
std::string file(const Bytes& data, bool closed = true) {
  Bytes header, out, end;
  header.text("");
  header.text("");
  out.bytes(std::as_bytes(std::span(mcap::kMagic.data(), mcap::kMagic.size())));
  out.record(Op::kHeader, header);
  out.bytes(data.view());
  if (closed) {
    end.u32(0);
    out.record(Op::kDataEnd, end);
    out.head(Op::kFooter, mcap::kFooterBytes);
    for (int i = 0; i < 5; ++i) out.u32(0);
    out.bytes(std::as_bytes(std::span(mcap::kMagic.data(), mcap::kMagic.size())));
  }
  const auto view = out.view();
  return {reinterpret_cast<const char*>(view.data()), view.size()};
}

void store(const std::string& path, const std::string& data) {
  std::ofstream(path, std::ios::binary) << data;
}

// ---- tests -------------------------------------------------------------------------------------

// Bytes that do not get smaller, so that no version of a compressor matters.
TEST_F(McapTest, FileIsTheGoldenOne) {
  const std::string golden = (test::golden() / "recording.mcap").string();
  auto recorder = Recorder::create(path());
  ASSERT_TRUE(recorder);
  ASSERT_TRUE(recorder->add_topic(
      {"/camera", "sensor_msgs/msg/Image", "cdr", "ros2msg", "uint32 height\nuint32 width\n"}));
  ASSERT_TRUE(recorder->add_topic({"/lidar", "xauto/Scan", "xauto"}));
  for (int i = 0; i < 4; ++i)  // two chunks: each is of at most a second
    ASSERT_TRUE(recorder->write(static_cast<std::size_t>(i % 2),
                                1'700'000'000'000'000'000 + i * 600'000'000LL,
                                noise(300, static_cast<unsigned>(i))));
  ASSERT_TRUE(recorder->close());
  if (std::getenv("XAUTO_UPDATE_GOLDEN") != nullptr)
    fs::copy_file(path(), golden, fs::copy_options::overwrite_existing);
  EXPECT_TRUE(test::slurp(path()) == test::slurp(golden)) << "is not " << golden;
  auto recording = Recording::open(golden);
  ASSERT_TRUE(recording && recording->verify());
  EXPECT_EQ(recording->topics()[0].schema, "uint32 height\nuint32 width\n");
  EXPECT_EQ(recording->topics()[0].schema_encoding, "ros2msg");
  EXPECT_EQ(recording->topics()[1].type, "xauto/Scan");
  EXPECT_EQ(recording->topics()[1].schema_encoding, "");
  EXPECT_EQ(recording->note(), "");
}

// Compressed where that helps; chunks that are full, and messages larger than a chunk.
TEST_F(McapTest, WhatIsWrittenComesBack) {
  auto recorder = Recorder::create(path());
  ASSERT_TRUE(recorder && recorder->add_topic({"a", "t", "f"}));
  Messages written;
  std::mt19937 random(1);
  for (int i = 0; i < 400; ++i) {
    const std::size_t size = i % 40 == 1 ? 3u << 20 : random() % 20'000;
    const auto data = i % 2 == 0 ? noise(size, static_cast<unsigned>(i))
                                 : std::vector<std::byte>(size, std::byte{7});
    const std::int64_t time =
        5'000'000'000 + i * 1'000'000 - static_cast<int>(random() % 20'000'000);
    ASSERT_TRUE(recorder->write(0, time, data));
    written.emplace_back(time,
                         std::string(reinterpret_cast<const char*>(data.data()), data.size()));
  }
  ASSERT_TRUE(recorder->close());
  std::stable_sort(written.begin(), written.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  const auto [read, end] = contents(path());
  EXPECT_EQ(end, "");
  EXPECT_TRUE(read == written);
  EXPECT_LT(fs::file_size(path()), 3u << 20) << "of 34 MB, all but 2 MB are one byte";
  EXPECT_TRUE(Recording::open(path())->verify());
}

TEST_F(McapTest, EveryCompressionIsRead) {
  const std::string long_text(300'000, 'x');
  for (const std::string compression : {"", "lz4", "zstd"}) {
    store(path(),
          file(chunk(5, 9, topic_a() + message(9, long_text) + message(5, ""), compression)));
    EXPECT_EQ(contents(path()), (std::pair<Messages, std::string>{{{5, ""}, {9, long_text}}, ""}))
        << compression;
  }
}

TEST_F(McapTest, MessagesInAndOutsideOfChunksComeByTime) {
  store(path(), file(chunk(10, 50, topic_a() + message(50, "c1") + message(10, "c2")) +
                     message(30, "m1") + message(20, "m2") + topic_a() + message(20, "m3") +
                     chunk(20, 20, message(20, "c3"), "zstd") + chunk(0, 0, Bytes())));
  EXPECT_EQ(contents(path()),
            (std::pair<Messages, std::string>{
                {{10, "c2"}, {20, "m2"}, {20, "m3"}, {20, "c3"}, {30, "m1"}, {50, "c1"}}, ""}));
}

TEST_F(McapTest, WhatWeDoNotKnowIsPassedOver) {
  Bytes own, longer = message(7, "x");
  own.text("somebody's own");
  Bytes later = record(static_cast<Op>(0x33), own) + record(static_cast<Op>(0xf0), own);
  Bytes attachment = record(Op::kAttachment, own) + record(Op::kMetadata, own);
  store(path(), file(topic_a() + later + attachment + message(1, "a") +
                     chunk(2, 2, later + message(2, "b")) + record(Op::kMessageIndex, own)));
  EXPECT_EQ(contents(path()), (std::pair<Messages, std::string>{{{1, "a"}, {2, "b"}}, ""}));
}

// ROS 2 writes such a file by `--storage-preset-profile fastwrite`.
TEST_F(McapTest, ManyMessagesOutsideOfChunksAreReadInParts) {
  Bytes all = topic_a();
  Messages expected;
  for (int i = 0; i < 100; ++i) {
    all = std::move(all) + message(static_cast<std::uint64_t>(i ^ 1), std::string(50'000, 'm'));
    expected.emplace_back(i, std::string(50'000, 'm'));
  }
  store(path(), file(all));
  EXPECT_EQ(contents(path()), (std::pair<Messages, std::string>{expected, ""}));
}

// A recorder that dies leaves what it had written: whole chunks, and a part of the next.
TEST_F(McapTest, FileWithoutAnEndIsReadUpToTheDamage) {
  auto recorder = Recorder::create(path());
  ASSERT_TRUE(recorder && recorder->add_topic({"a", "t", "f"}));
  for (int i = 0; i < 10; ++i)
    ASSERT_TRUE(recorder->write(0, i * 2'000'000'000LL, noise(100, static_cast<unsigned>(i))));
  ASSERT_TRUE(recorder->close());
  const std::string whole = test::slurp(path());
  std::size_t last = 0;
  std::map<std::size_t, int> how_often;
  for (std::size_t size = 0; size < whole.size(); size += 3) {
    store(path("b.mcap"), whole.substr(0, size));
    const auto [read, end] = contents(path("b.mcap"));
    ++how_often[read.size()];
    EXPECT_GE(read.size(), last) << "more bytes, fewer messages";
    last = read.size();
    if (read.empty()) {
      EXPECT_TRUE(end == "is not an MCAP file" || end == "is empty" || end == "has no topics" ||
                  end == "has no messages")
          << end;
      continue;
    }
    EXPECT_EQ(end, "");
    const auto note = Recording::open(path("b.mcap"))->note();
    EXPECT_NE(note.find("its recorder did not close it: read up to byte "), std::string::npos)
        << note;
  }
  EXPECT_EQ(how_often.size(), 11u) << "one message per chunk: any number of them can be left";
  // A file system may leave zeros where nothing was written yet.
  store(path("b.mcap"), whole.substr(0, whole.size() / 2) + std::string(5000, '\0'));
  EXPECT_GE(contents(path("b.mcap")).first.size(), 3u);
}

/// Of a closed file no byte of a message can change unseen: its chunk has a checksum.
TEST_F(McapTest, ChangedFileIsRefusedOrReadAsItWas) {
  auto recorder = Recorder::create(path());
  ASSERT_TRUE(recorder && recorder->add_topic({"a", "t", "f"}));
  for (int i = 0; i < 3; ++i)
    ASSERT_TRUE(recorder->write(0, i * 2'000'000'000LL, noise(50, static_cast<unsigned>(i))));
  ASSERT_TRUE(recorder->close());
  const std::string whole = test::slurp(path());
  const auto right = contents(path());
  int refused = 0;
  for (std::size_t at = 0; at < whole.size(); at += 3) {
    std::string changed = whole;
    changed[at] = static_cast<char>(changed[at] ^ 0x41);
    store(path("b.mcap"), changed);
    const auto read = contents(path("b.mcap"));
    if (!read.second.empty()) {
      ++refused;
    } else {
      auto recording = Recording::open(path("b.mcap"));
      EXPECT_TRUE(read.first == right.first || !recording->note().empty()) << at;
      // The whole file's checksums are wrong, or the summary's, which says where everything is.
      if (!recording->verify()) ++refused;
    }
  }
  EXPECT_GT(refused, static_cast<int>(whole.size()) / 3 - 20) << "of " << whole.size() / 3;
}

TEST_F(McapTest, LimitsHold) {
  Bytes big;
  big.head(Op::kMessage, mcap::kMessageHead + kMaxMessageBytes + 1);
  store(path(), file(topic_a() + big, false));
  fs::resize_file(path(), fs::file_size(path()) + mcap::kMessageHead + kMaxMessageBytes + 1);
  EXPECT_EQ(contents(path()).second, "has no messages");
  EXPECT_NE(contents(path()).first.size(), 1u);

  Bytes schema;
  put(schema, mcap::Schema{1, "t", "ros2msg", std::string(kMaxSchemaBytes + 1, 'x')});
  store(path(), file(schema));
  EXPECT_NE(contents(path()).second.find("its schema is longer than 1048576 bytes"),
            std::string::npos);

  Bytes channels;
  for (std::size_t i = 0; i <= kMaxTopics; ++i)
    put(channels, mcap::Channel{static_cast<std::uint16_t>(i), 0, "/" + std::to_string(i), "", {}});
  store(path(), file(channels));
  EXPECT_EQ(contents(path()).second, "has more than 4096 channels");
}

/// Chunks that all overlap: no reader could put their messages in order without holding them all.
TEST_F(McapTest, ChunksThatOverlapBeyondTheMemoryBoundAreRefused) {
  const std::string most(900'000, 'x');
  const auto overlapping = [&](std::uint64_t start) {
    return chunk(start, 1000 + start, message(start, "first") + message(1000 + start, most),
                 "zstd");
  };
  store(path(), file(topic_a() + overlapping(0) + overlapping(1) + overlapping(2)));
  auto reader = open_mcap(path(), 2'000'000);
  ASSERT_TRUE(reader);
  EXPECT_TRUE((*reader)->next() && (*reader)->next()) << "two have room";
  const auto third = (*reader)->next();
  ASSERT_FALSE(third);
  EXPECT_NE(third.error().what.find("more than 2000000 bytes overlap in time"), std::string::npos);
  EXPECT_EQ(contents(path()).first.size(), 6u) << "fewer than 512 MiB";
  // What does not overlap needs no room beside the other.
  store(path(), file(topic_a() + overlapping(0) + overlapping(2000) + overlapping(4000)));
  reader = open_mcap(path(), 2'000'000);
  for (int i = 0; i < 6; ++i) EXPECT_TRUE((*reader)->next().value()) << i;
  EXPECT_FALSE((*reader)->next().value());
}

}  // namespace
}  // namespace xauto::record

// SPDX-License-Identifier: Apache-2.0
#include "record/salvage.h"

#include <cstring>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "record/mcap_format.h"

#include "sqlite_file.h"

namespace xauto::record {
namespace {

namespace fs = std::filesystem;
using mcap::Bytes;
using mcap::Op;

constexpr std::int64_t kStart = 1'700'000'000'000'000'000, kMs = 1'000'000;

std::vector<std::byte> number(std::uint64_t value) {
  std::vector<std::byte> bytes(8);
  std::memcpy(bytes.data(), &value, 8);
  return bytes;
}

/// A Message record of channel 1; `time`, `channel` and `length` may be wrong.
struct Written {
  std::uint64_t number = 0;
  std::uint64_t time = 0;
  std::uint16_t channel = 1;
  std::uint64_t more_length = 0;
};
void put(Bytes& out, const Written& m) {
  out.head(Op::kMessage, mcap::kMessageHead + 8 + m.more_length);
  out.u16(m.channel);
  out.u32(0);
  out.u64(m.time);
  out.u64(m.time);
  out.bytes(number(m.number));
}
std::vector<Written> twenty() {
  std::vector<Written> all;
  for (std::uint64_t i = 0; i < 20; ++i)
    all.push_back(
        {i, static_cast<std::uint64_t>(kStart + static_cast<std::int64_t>(i) * 10 * kMs)});
  return all;
}

std::vector<Written> some(std::ptrdiff_t from, std::ptrdiff_t to) {
  const std::vector<Written> all = twenty();
  return {all.begin() + from, all.begin() + to};
}

class SalvageTest : public testing::Test {
 protected:
  SalvageTest()
      : folder_(fs::temp_directory_path() / ("xauto_salvage." + std::to_string(getpid()))) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~SalvageTest() override { fs::remove_all(folder_); }
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_ / name).string();
  }

  /// Header, schema, channel 1.
  static Bytes front() {
    Bytes out, header;
    out.bytes(std::as_bytes(std::span(mcap::kMagic.data(), mcap::kMagic.size())));
    header.text("ros2");
    header.text("a test");
    out.record(Op::kHeader, header);
    mcap::put(out, mcap::Schema{1, "a/msg/B", "ros2msg", "uint64 data\n"});
    mcap::put(out, mcap::Channel{1, 1, "/x", "cdr", {}});
    return out;
  }
  static void put_chunk(Bytes& out, const std::vector<Written>& messages,
                        std::uint32_t wrong_crc = 0) {
    Bytes records;
    for (const Written& m : messages) put(records, m);
    mcap::ChunkHead head;
    head.start = messages.front().time;
    head.end = messages.back().time;
    head.uncompressed_bytes = head.bytes = records.size();
    head.uncompressed_crc = mcap::crc32(records.view()) + wrong_crc;
    mcap::put(out, head);
    out.bytes(records.view());
  }
  void write(const std::string& name, const Bytes& bytes) const {
    std::ofstream(path(name), std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.view().data()),
               static_cast<std::streamsize>(bytes.size()));
  }
  /// The numbers that can be had of it.
  [[nodiscard]] std::vector<std::uint64_t> numbers(const std::string& name,
                                                   Salvaged* of = nullptr) const {
    std::vector<std::uint64_t> found;
    const auto salvaged =
        salvage(path(name), [&](const Topic& topic, std::int64_t stamp_ns, auto data) -> Status {
          EXPECT_EQ(topic.name, "/x");
          EXPECT_GE(stamp_ns, 0);
          std::uint64_t value = 0;
          EXPECT_EQ(data.size(), 8u);
          std::memcpy(&value, data.data(), std::min<std::size_t>(data.size(), 8));
          found.push_back(value);
          return {};
        });
    EXPECT_TRUE(salvaged) << salvaged.error().to_string();
    EXPECT_EQ(salvaged ? salvaged->messages : 0, found.size());
    if (salvaged && of != nullptr) *of = *salvaged;
    return found;
  }
  [[nodiscard]] std::vector<std::uint64_t> all_but(std::vector<std::uint64_t> left_out) const {
    std::vector<std::uint64_t> expected;
    for (std::uint64_t i = 0; i < 20; ++i)
      if (std::find(left_out.begin(), left_out.end(), i) == left_out.end()) expected.push_back(i);
    return expected;
  }

  fs::path folder_;
};

struct OneBad {
  const char* name;
  void (*spoil)(Written&);
  const char* told;
};
const OneBad kOneBad[] = {
    {"stamp", [](Written& m) { m.time = UINT64_MAX - 4; }, "timestamp 18446744073709551611"},
    {"channel", [](Written& m) { m.channel = 7; }, "there is no channel 7"},
};

// One bad record among nineteen good ones: in a chunk, and without chunks.
TEST_F(SalvageTest, OneBadMessageIsLeftOutAndToldAndTheOthersAreThere) {
  for (const OneBad& bad : kOneBad) {
    std::vector<Written> messages = twenty();
    bad.spoil(messages[10]);
    Bytes chunked = front(), plain = front();
    put_chunk(chunked, messages);
    for (const Written& m : messages) put(plain, m);
    for (const Bytes* bytes : {&chunked, &plain}) {
      write("a.mcap", *bytes);
      Salvaged of;
      EXPECT_EQ(numbers("a.mcap", &of), all_but({10})) << bad.name;
      EXPECT_EQ(of.faults, 2u) << "it, and that the file has no end";
      ASSERT_FALSE(of.left_out.empty());
      EXPECT_NE(of.left_out[0].find(bad.told), std::string::npos) << of.left_out[0];
    }
  }
}

// A length that lies hides what it spans; reading goes on behind it.
TEST_F(SalvageTest, ReadingGoesOnBehindALengthThatLies) {
  std::vector<Written> messages = twenty();
  messages[10].more_length = 1u << 30;
  Bytes plain = front();
  for (const Written& m : messages) put(plain, m);
  write("a.mcap", plain);
  Salvaged of;
  EXPECT_EQ(numbers("a.mcap", &of), all_but({10}));
  EXPECT_NE(of.left_out[0].find("longer than what follows"), std::string::npos) << of.left_out[0];

  Bytes chunked = front();  // the record of the first chunk says that it is longer
  put_chunk(chunked, some(0, 10));
  put_chunk(chunked, some(10, 20));
  std::vector<std::byte> bytes(chunked.view().begin(), chunked.view().end());
  const std::size_t first = front().size();
  bytes[first + 5] = std::byte{0x7f};
  std::ofstream(path("b.mcap"), std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
  const std::vector<std::uint64_t> found = numbers("b.mcap");
  EXPECT_TRUE(std::find(found.begin(), found.end(), 19) != found.end())
      << "the second chunk is there";
}

// The format lets a record be longer than its fields, and the reader does.
TEST_F(SalvageTest, OfAChunkWithMoreBehindItsRecordsTheRecordsAreTaken) {
  Bytes first = front(), second;
  put_chunk(first, some(0, 10));
  put_chunk(second, some(10, 20));
  std::string bytes(reinterpret_cast<const char*>(first.view().data()), first.size());
  char& length = bytes[front().size() + 1];
  ASSERT_LT(static_cast<unsigned char>(length), 240);
  length = static_cast<char>(length + 16);
  bytes.append(16, '\0');
  bytes.append(reinterpret_cast<const char*>(second.view().data()), second.size());
  std::ofstream(path("a.mcap"), std::ios::binary) << bytes;
  Salvaged of;
  EXPECT_EQ(numbers("a.mcap", &of), all_but({}));
  ASSERT_EQ(of.faults, 2u) << "that, and that the file has no end";
  EXPECT_NE(of.left_out[0].find("16 bytes behind its records"), std::string::npos);
}

// The summary repeats schemas and channels: there is one more place to have them from.
TEST_F(SalvageTest, WhereASchemaIsDamagedThatOfTheSummaryCounts) {
  Bytes out = front();
  for (const Written& m : twenty()) put(out, m);
  mcap::put(out, mcap::Schema{1, "a/msg/B", "ros2msg", "uint64 data\n"});
  mcap::put(out, mcap::Channel{1, 1, "/x", "cdr", {}});
  std::string bytes(reinterpret_cast<const char*>(out.view().data()), out.size());
  const std::size_t schema =
      bytes.find("a/msg/B") - 4 - 2 - 9;  // its length, the schema's id, the record's head
  ASSERT_EQ(static_cast<mcap::Op>(bytes[schema]), mcap::Op::kSchema);
  bytes[schema] = '\x7f';
  std::ofstream(path("a.mcap"), std::ios::binary) << bytes;
  Salvaged of;
  EXPECT_EQ(numbers("a.mcap", &of), all_but({}));
  EXPECT_EQ(of.faults, 3u) << "the schema, its channel, and that the file has no end";
}

TEST_F(SalvageTest, WhatAChecksumContradictsIsLeftOutWhole) {
  Bytes out = front();
  put_chunk(out, some(0, 10), 1);
  put_chunk(out, some(10, 20));
  write("a.mcap", out);
  EXPECT_EQ(numbers("a.mcap"), all_but({0, 1, 2, 3, 4, 5, 6, 7, 8, 9}));
}

TEST_F(SalvageTest, AFileWhoseBeginningIsGoneGivesWhatFollows) {
  // Without the magic: channels are known from what follows it, as in a chunk that has them.
  Bytes out = front();
  put_chunk(out, twenty());
  std::vector<std::byte> bytes(out.view().begin(), out.view().end());
  bytes[0] = std::byte{0};
  std::ofstream(path("a.mcap"), std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
  Salvaged of;
  (void)numbers("a.mcap", &of);
  ASSERT_FALSE(of.left_out.empty());
  EXPECT_NE(of.left_out[0].find("does not begin as an MCAP file"), std::string::npos);
}

// SQLite itself makes the file, and the bad rows.
TEST_F(SalvageTest, RowsOfSqliteThatAreNoneAreLeftOut) {
  std::string sql =
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
      " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
      "INSERT INTO topics VALUES (1, '/x', 'a/msg/B', 'cdr', '');"
      "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER "
      "NOT NULL, data BLOB);";
  for (int i = 0; i < 20; ++i)
    sql += "INSERT INTO messages VALUES (" + std::to_string(i + 1) + (i == 4 ? ", 9, " : ", 1, ") +
           (i == 7 ? "-5" : std::to_string(kStart + i * 10 * kMs)) +
           (i == 11 ? ", NULL);"
                    : ", x'" + std::string(1, "0123456789abcdef"[i / 16]) +
                          std::string(1, "0123456789abcdef"[i % 16]) + "00000000000000');");
  test::run_sql(path("a.db3"), sql);
  Salvaged of;
  EXPECT_EQ(numbers("a.db3", &of), all_but({4, 7, 11}));
  EXPECT_EQ(of.faults, 3u);
  EXPECT_FALSE(Recording::open(path("a.db3")) && [&] {
    auto recording = Recording::open(path("a.db3"));
    for (;;) {
      const auto message = recording->next();
      if (!message) return false;
      if (!*message) return true;
    }
  }()) << "and it is refused as it is";
}

/// numbers from..to-1, `step_ns` apart, as SQLite's own file.
void in_sqlite(const std::string& path, std::size_t from, std::size_t to, std::size_t step_ns) {
  std::vector<std::string> rows;
  for (std::size_t i = from; i < to; ++i)
    rows.push_back(fmt::format("1, {}, x'{:02x}{:02x}000000000000'",
                               static_cast<std::size_t>(kStart) + i * step_ns, i % 256, i / 256));
  test::write_sqlite(path, {"'/x', 'a/msg/B', 'cdr'"}, rows);
}

// A page in the middle that is overwritten: what lies before it and behind it is there.
TEST_F(SalvageTest, SqliteIsReadFromBothEnds) {
  in_sqlite(path("a.db3"), 0, 4000, 1);
  const auto pages = fs::file_size(path("a.db3")) / 4096;
  std::fstream file(path("a.db3"), std::ios::binary | std::ios::in | std::ios::out);
  file.seekp(static_cast<std::streamoff>(pages / 2 * 4096));
  file << std::string(4096, '\x55');
  file.close();
  Salvaged of;
  const std::vector<std::uint64_t> found = numbers("a.db3", &of);
  EXPECT_GE(of.faults, 1u);
  EXPECT_GT(found.size(), 3000u);
  EXPECT_EQ(std::count(found.begin(), found.end(), 0), 1);
  EXPECT_EQ(std::count(found.begin(), found.end(), 3999), 1);
  std::vector<std::uint64_t> sorted = found;
  std::sort(sorted.begin(), sorted.end());
  EXPECT_EQ(std::unique(sorted.begin(), sorted.end()), sorted.end()) << "none twice";
}

// ---- folders ------------------------------------------------------------------------------------

TEST_F(SalvageTest, AFolderTellsOfEachFileThatIsDamagedWhereverItStands) {
  const auto good = [&](const std::string& name, std::size_t from, std::size_t to) {
    if (name.ends_with(".db3")) return in_sqlite(path(name), from, to, kMs);
    auto recorder = Recorder::create(path(name));
    ASSERT_TRUE(recorder && recorder->add_topic({"/x", "a/msg/B", "cdr"}));
    for (std::size_t i = from; i < to; ++i)
      ASSERT_TRUE(recorder->write(0, kStart + static_cast<std::int64_t>(i) * kMs, number(i)));
    ASSERT_TRUE(recorder->close());
  };
  const std::string bad[] = {"", std::string(mcap::kMagic), std::string(mcap::kMagic) + "\x01\x08",
                             "no recording"};
  for (const char* suffix : {".mcap", ".db3"})
    for (std::size_t at = 0; at < 3; ++at)
      for (const std::string& content : bad) {
        fs::remove_all(path("bag"));
        fs::create_directories(path("bag"));
        for (std::size_t i = 0; i < 3; ++i) {
          const std::string name = "bag/bag_" + std::to_string(i) + suffix;
          if (i == at)
            std::ofstream(path(name), std::ios::binary) << content;
          else
            good(name, i * 10, i * 10 + 10);
        }
        const auto recording = Recording::open(path("bag"));
        ASSERT_TRUE(recording) << recording.error().to_string();
        EXPECT_EQ(recording->num_messages(), 20u);
        EXPECT_NE(recording->note().find("bag_" + std::to_string(at) + suffix), std::string::npos)
            << "'" << content << "': " << recording->note();
      }
}

TEST_F(SalvageTest, AFolderTellsWhatItsMetadataHasAndItHasNot) {
  auto recorder = Recorder::create(path("bag"));
  ASSERT_TRUE(recorder && recorder->add_topic({"/x", "a/msg/B", "cdr"}));
  ASSERT_TRUE(recorder->write(0, kStart, number(0)));
  ASSERT_TRUE(recorder->close());
  EXPECT_EQ(Recording::open(path("bag"))->note(), "");
  std::ofstream(path("bag/metadata.yaml"))
      << "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  message_count: "
         "3\n"
         "  compression_mode: \"\"\n  relative_file_paths:\n    - bag_0.mcap\n    - "
         "\"bag_1.mcap\"\n  files:\n    - path: bag_0.mcap\n"
         "      message_count: 1\n";
  const std::string note = Recording::open(path("bag"))->note();
  EXPECT_NE(note.find("names 'bag_1.mcap', which is not there"), std::string::npos) << note;
  EXPECT_NE(note.find("counts 3 messages, 1 are there"), std::string::npos) << note;
}

// ---- a medium that cannot be written ------------------------------------------------------------

// As another user, since root may write everywhere: SQLite would make a -shm beside a bag in WAL mode.
TEST_F(SalvageTest, AClosedBagInWalModeIsReadWhereNobodyMayWrite) {
  if (getuid() != 0) GTEST_SKIP() << "only root can become another user";
  const std::string folder = path("r?o#50%"), bag = folder + "/a.db3";
  fs::create_directories(folder);
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(bag.c_str(), &database), SQLITE_OK);
  ASSERT_EQ(
      sqlite3_exec(
          database,
          "PRAGMA journal_mode=WAL;"
          "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
          " serialization_format TEXT NOT NULL);INSERT INTO topics VALUES (1, '/x', 'a/msg/B', "
          "'cdr');"
          "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
          " timestamp INTEGER NOT NULL, data BLOB NOT NULL);INSERT INTO messages VALUES (1, 1, 5, "
          "x'00');",
          nullptr, nullptr, nullptr),
      SQLITE_OK);
  std::error_code error;
  fs::copy_file(bag + "-wal", path("wal"), error);  // as a recorder leaves it that is killed
  sqlite3_close(database);
  fs::permissions(folder, fs::perms(0555));
  fs::permissions(folder_, fs::perms(0755));
  const auto as_nobody = [&](const std::string& file) {
    int ends[2];
    EXPECT_EQ(pipe(ends), 0);
    const pid_t child = fork();
    if (child == 0) {
      if (setgid(65534) != 0 || setuid(65534) != 0) _exit(3);
      const auto opened = Recording::open(file);
      const std::string said =
          opened ? "messages " + std::to_string(opened->num_messages()) : opened.error().what;
      _exit(::write(ends[1], said.data(), said.size()) == static_cast<ssize_t>(said.size()) ? 0
                                                                                            : 4);
    }
    close(ends[1]);
    std::string said(4096, '\0');
    said.resize(
        static_cast<std::size_t>(std::max<ssize_t>(::read(ends[0], said.data(), said.size()), 0)));
    close(ends[0]);
    waitpid(child, nullptr, 0);
    return said;
  };
  EXPECT_EQ(as_nobody(bag), "messages 1");
  fs::permissions(folder, fs::perms(0755));
  fs::copy_file(path("wal"), bag + "-wal");
  fs::permissions(folder, fs::perms(0555));
  EXPECT_NE(as_nobody(bag).find("a journal beside it"), std::string::npos)
      << "what it holds is part of it";
  fs::permissions(folder, fs::perms(0755));
}

TEST(Gaps, AreToldWithPlaceAndLength) {
  EXPECT_EQ(gap_text(30'400 * kMs, kStart),
            "53.9 years without a message, from 1970-01-01 00:00:30.400 to "
            "2023-11-14 22:13:20.000 UTC");
  EXPECT_EQ(gap_text(kStart, kStart + 90'000 * kMs),
            "1.5 minutes without a message, from 2023-11-14 22:13:20.000 to "
            "2023-11-14 22:14:50.000 UTC");
}

}  // namespace
}  // namespace xauto::record

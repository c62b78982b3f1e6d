// SPDX-License-Identifier: Apache-2.0
#include "record/recording.h"

#include <algorithm>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "../golden_cases.h"
#include "sqlite_file.h"

namespace xauto::record {
namespace {

namespace fs = std::filesystem;

class RecordingTest : public testing::Test {
 protected:
  RecordingTest()
      : folder_(fs::temp_directory_path() / ("xauto_record_test." + std::to_string(getpid()))) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~RecordingTest() override { fs::remove_all(folder_); }
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_ / name).string();
  }

  fs::path folder_;
};

std::vector<std::byte> bytes(const std::string& text) {
  const auto* data = reinterpret_cast<const std::byte*>(text.data());
  return {data, data + text.size()};
}

Status record_two(const std::string& path) {
  XAUTO_ASSIGN(auto recorder, Recorder::create(path));
  XAUTO_ASSIGN(const std::size_t camera,
               recorder.add_topic({"/camera", "sensor_msgs/msg/Image", "cdr"}));
  XAUTO_ASSIGN(const std::size_t lidar,
               recorder.add_topic({"/lidar \"front\"", "xauto/Scan", "xauto"}));
  XAUTO_TRY(recorder.write(lidar, 2000, bytes("second")));
  XAUTO_TRY(recorder.write(camera, 1000, bytes("first")));
  XAUTO_TRY(recorder.write(camera, 2000, {}));
  return recorder.close();
}

/// The same in SQLite.
void sqlite_two(const std::string& path) {
  test::write_sqlite(
      path,
      {"'/camera', 'sensor_msgs/msg/Image', 'cdr'", "'/lidar \"front\"', 'xauto/Scan', 'xauto'"},
      {"2, 2000, CAST('second' AS BLOB)", "1, 1000, CAST('first' AS BLOB)", "1, 2000, x''"});
}

TEST_F(RecordingTest, MessagesComeBackByTimeThenInTheOrderWritten) {
  const auto written = record_two(path("a.mcap"));
  ASSERT_TRUE(written) << written.error().to_string();
  sqlite_two(path("a.db3"));
  for (const char* name : {"a.mcap", "a.db3"}) {
    auto recording = Recording::open(path(name));
    ASSERT_TRUE(recording) << recording.error().to_string();
    EXPECT_EQ(recording->num_messages(), 3u);
    ASSERT_EQ(recording->topics().size(), 2u);
    EXPECT_EQ(recording->topics()[0].name, "/camera");
    EXPECT_EQ(recording->topics()[1].serialization_format, "xauto");
    std::vector<std::string> seen;
    for (;;) {
      const auto message = recording->next();
      ASSERT_TRUE(message) << message.error().to_string();
      if (!*message) break;
      const auto& data = (*message)->data;
      seen.push_back(std::to_string((*message)->topic) + " " +
                     std::to_string((*message)->timestamp_ns) + " " +
                     std::string(reinterpret_cast<const char*>(data.data()), data.size()));
    }
    EXPECT_EQ(seen, (std::vector<std::string>{"0 1000 first", "1 2000 second", "0 2000 "}));
    EXPECT_FALSE(recording->next().value()) << "the end stays the end";
  }
}

TEST_F(RecordingTest, FolderIsWhatRosbag2Wants) {
  ASSERT_TRUE(record_two(path("drive/")));
  EXPECT_TRUE(Recording::open(path("drive")));
  EXPECT_TRUE(Recording::open(path("drive/drive_0.mcap")));
  EXPECT_EQ(test::slurp(path("drive/metadata.yaml")),
            test::slurp(test::golden() / "metadata.yaml"));
}

// The layouts of rosbag2's older and newer storage versions.
TEST_F(RecordingTest, RecordingsOfAllSchemaVersionsAreRead) {
  const std::string rows = "INSERT INTO messages VALUES (1, 7, 5, x'00');";
  const std::string messages =
      "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
      " timestamp INTEGER NOT NULL, data BLOB NOT NULL);";
  test::run_sql(
      path("v1.db3"),
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
      " serialization_format TEXT NOT NULL); INSERT INTO topics VALUES (7, 'a', 'b', 'cdr');" +
          messages + rows);
  test::run_sql(
      path("v4.db3"),
      "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
      "INSERT INTO schema VALUES (4, 'jazzy');"
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
      " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,"
      " type_description_hash TEXT NOT NULL); INSERT INTO topics VALUES (7, 'a', 'b', 'cdr', "
      "'', '');" +
          messages + rows);
  for (const char* name : {"v1.db3", "v4.db3"}) {
    auto recording = Recording::open(path(name));
    ASSERT_TRUE(recording) << recording.error().to_string();
    EXPECT_EQ(recording->next().value()->timestamp_ns, 5);
  }
}

TEST_F(RecordingTest, RecorderNeverOverwritesAndChecksWhatItIsGiven) {
  std::ofstream(path("there.mcap")) << "precious";
  EXPECT_EQ(Recorder::create(path("there.mcap")).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(test::slurp(path("there.mcap")), "precious");
  EXPECT_FALSE(Recorder::create(path("no/such/a.mcap")));
  EXPECT_FALSE(Recorder::create(path("no/such/folder")));
  EXPECT_EQ(Recorder::create(path("a.db3")).error().what, "SQLite is read and not written");
  auto recorder = Recorder::create(path("a.mcap"));
  ASSERT_TRUE(recorder);
  EXPECT_FALSE(recorder->add_topic({"", "t", "f"}));
  ASSERT_TRUE(recorder->add_topic({"a", "t", "f"}));
  EXPECT_FALSE(recorder->add_topic({"a", "t", "f"}));
  EXPECT_FALSE(recorder->write(1, 0, {}));
  EXPECT_FALSE(recorder->write(0, -1, {}));
  EXPECT_FALSE(recorder->write(0, kMaxTimestampNs + 1, {}));
  EXPECT_TRUE(recorder->write(0, kMaxTimestampNs, {}));
  EXPECT_TRUE(recorder->close());
  EXPECT_FALSE(recorder->write(0, 0, {})) << "closed";
}

// As `ros2 bag record --max-bag-size` splits one, and as several recorders at once would.
TEST_F(RecordingTest, FilesOfAFolderAreOneRecording) {
  for (const std::string suffix : {".db3", ".mcap"}) {
    const std::string bag = path("bag" + suffix);
    fs::create_directories(bag);
    for (int file = 0; file < 12; ++file) {
      const std::string name = bag + "/bag_" + std::to_string(file) + suffix;
      const std::string topic = "of " + std::to_string(file % 2);
      if (suffix == ".db3") {
        std::vector<std::string> rows;
        for (int i = 0; i < 20; ++i)
          rows.push_back("1, " + std::to_string(10 * file + i) + ", CAST('" + std::to_string(file) +
                         "' AS BLOB)");
        test::write_sqlite(name, {"'" + topic + "', 't', 'f'"}, rows);
        continue;
      }
      auto recorder = Recorder::create(name);
      ASSERT_TRUE(recorder && recorder->add_topic({topic, "t", "f"}));
      for (int i = 0; i < 20; ++i)
        ASSERT_TRUE(recorder->write(0, 10 * file + i, bytes(std::to_string(file))));
      ASSERT_TRUE(recorder->close());
    }
    auto recording = Recording::open(bag);
    ASSERT_TRUE(recording) << recording.error().to_string();
    EXPECT_EQ(recording->num_messages(), 240u);
    ASSERT_EQ(recording->topics().size(), 2u);
    std::vector<std::pair<std::int64_t, int>> seen;
    for (;;) {
      const auto message = recording->next();
      ASSERT_TRUE(message) << message.error().to_string();
      if (!*message) break;
      const auto& data = (*message)->data;
      const int file =
          std::stoi(std::string(reinterpret_cast<const char*>(data.data()), data.size()));
      EXPECT_EQ((*message)->topic, static_cast<std::size_t>(file % 2));
      seen.emplace_back((*message)->timestamp_ns, file);
    }
    EXPECT_EQ(seen.size(), 240u);
    EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end())) << suffix;
  }
  auto other = Recorder::create(path("bag.mcap/bag_12.mcap"));
  ASSERT_TRUE(other && other->add_topic({"of 1", "another", "f"}) && other->write(0, 0, {}) &&
              other->close());
  EXPECT_EQ(Recording::open(path("bag.mcap")).error().what,
            "topic 'of 1' has another type than in the files before");
}

TEST_F(RecordingTest, RecorderThatIsDroppedKeepsItsMessages) {
  {
    auto recorder = Recorder::create(path("a.mcap"));
    ASSERT_TRUE(recorder && recorder->add_topic({"a", "t", "f"}));
    for (int i = 0; i < 1000; ++i) ASSERT_TRUE(recorder->write(0, i, bytes("x")));
  }
  EXPECT_EQ(Recording::open(path("a.mcap"))->num_messages(), 1000u);
}

TEST_F(RecordingTest, MessageBeyondTheLimitIsRefused) {
  sqlite_two(path("a.db3"));
  test::run_sql(path("a.db3"), "UPDATE messages SET data = zeroblob(" +
                                   std::to_string(kMaxMessageBytes + 1) + ") WHERE id = 2");
  auto recording = Recording::open(path("a.db3"));
  ASSERT_TRUE(recording) << recording.error().to_string();
  const auto message = recording->next();
  ASSERT_FALSE(message);
  // By us, or by an older SQLite, which refuses the whole row.
  EXPECT_NE(message.error().what.find("than 67108864 bytes"), std::string::npos)
      << message.error().what;
}

TEST_F(RecordingTest, FolderThatCannotBeReadIsRefused) {
  fs::create_directories(folder_ / "bag");
  EXPECT_EQ(Recording::open(path("bag")).error().what, "holds no .mcap file and no .db3 file");
  std::ofstream(path("bag/bag_0.db3.zstd"));
  EXPECT_EQ(Recording::open(path("bag")).error().what,
            "holds compressed files, such as 'bag_0.db3.zstd'");
  std::ofstream(path("bag/bag_0.db3"));
  std::ofstream(path("bag/metadata.yaml"))
      << "rosbag2_bagfile_information:\n  compression_mode: MESSAGE\n";
  EXPECT_EQ(Recording::open(path("bag")).error().what,
            "holds messages that are compressed one by one");
  std::ofstream(path("bag/bag_0.mcap"));
  EXPECT_EQ(Recording::open(path("bag")).error().what, "holds .mcap files and .db3 files");
  fs::create_directories(folder_ / "many");
  for (std::size_t i = 0; i <= kMaxFiles; ++i)
    std::ofstream(path("many/many_" + std::to_string(i) + ".mcap"));
  EXPECT_EQ(Recording::open(path("many")).error().what, "holds 257 files, more than 256");
  std::ofstream(path("text.txt"));
  EXPECT_EQ(Recording::open(path("text.txt")).error().what, "is neither .mcap nor .db3");
  EXPECT_EQ(Recording::open(path("nothing")).error().code, ErrorCode::kNotFound);
}

/// A file of cut or flipped bytes is refused or read, never more.
TEST_F(RecordingTest, DamagedFilesAreRefusedOrReadToTheirEnd) {
  sqlite_two(path("a.db3"));
  const std::string whole = test::slurp(path("a.db3"));
  int refused = 0;
  for (std::size_t at = 0; at < whole.size(); at += 61) {
    std::string damaged = whole;
    if (at % 2 == 0)
      damaged.resize(at);
    else
      damaged[at] = static_cast<char>(damaged[at] ^ 0x55);
    std::ofstream(path("b.db3"), std::ios::binary) << damaged;
    auto recording = Recording::open(path("b.db3"));
    if (!recording) {
      ++refused;
      EXPECT_FALSE(recording.error().what.empty());
      continue;
    }
    for (int i = 0; i < 4; ++i) {
      const auto message = recording->next();
      if (!message) ++refused;
      if (!message || !*message) break;
    }
  }
  EXPECT_GT(refused, 50);
}

}  // namespace
}  // namespace xauto::record

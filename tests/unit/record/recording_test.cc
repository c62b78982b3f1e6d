// SPDX-License-Identifier: Apache-2.0
#include "record/recording.h"

#include <algorithm>
#include <fstream>

#include <gtest/gtest.h>
#include <sqlite3.h>
#include <unistd.h>

#include "../golden_cases.h"

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

void run_sql(const std::string& path, const std::string& sql) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  char* message = nullptr;
  EXPECT_EQ(
      sqlite3_exec(database, ("PRAGMA synchronous=OFF;" + sql).c_str(), nullptr, nullptr, &message),
      SQLITE_OK)
      << (message != nullptr ? message : "");
  sqlite3_free(message);
  sqlite3_close(database);
}

/// One text per row, columns joined with '|'.
std::vector<std::string> query(const std::string& path, const std::string& sql) {
  sqlite3* database = nullptr;
  EXPECT_EQ(sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY, nullptr), SQLITE_OK);
  std::vector<std::string> rows;
  const auto collect = [](void* out, int columns, char** values, char**) {
    std::string row;
    for (int i = 0; i < columns; ++i) {
      if (i > 0) row += '|';
      if (values[i] != nullptr) row += values[i];
    }
    static_cast<std::vector<std::string>*>(out)->push_back(row);
    return 0;
  };
  EXPECT_EQ(sqlite3_exec(database, sql.c_str(), collect, &rows, nullptr), SQLITE_OK) << sql;
  sqlite3_close(database);
  return rows;
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

TEST_F(RecordingTest, MessagesComeBackByTimeThenInTheOrderWritten) {
  const auto written = record_two(path("a.db3"));
  ASSERT_TRUE(written) << written.error().to_string();
  auto recording = Recording::open(path("a.db3"));
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

TEST_F(RecordingTest, FolderIsWhatRosbag2Wants) {
  ASSERT_TRUE(record_two(path("drive/")));
  EXPECT_TRUE(Recording::open(path("drive")));
  EXPECT_TRUE(Recording::open(path("drive/drive_0.mcap")));
  EXPECT_EQ(test::slurp(path("drive/metadata.yaml")),
            test::slurp(test::golden() / "metadata.yaml"));
}

TEST_F(RecordingTest, DatabaseIsWhatRosbag2Wants) {
  ASSERT_TRUE(record_two(path("drive.db3")));
  const std::string database = path("drive.db3");
  EXPECT_EQ(query(database, "SELECT schema_version, ros_distro FROM schema"),
            std::vector<std::string>{"3|"});
  EXPECT_EQ(
      query(database, "SELECT name FROM sqlite_master ORDER BY name"),
      (std::vector<std::string>{"messages", "metadata", "schema", "timestamp_idx", "topics"}));
  EXPECT_EQ(query(database,
                  "SELECT id, name, type, serialization_format, offered_qos_profiles FROM topics"),
            (std::vector<std::string>{"1|/camera|sensor_msgs/msg/Image|cdr|[]",
                                      "2|/lidar \"front\"|xauto/Scan|xauto|[]"}));
  EXPECT_EQ(query(database, "SELECT metadata_version FROM metadata"),
            std::vector<std::string>{"5"});
}

// The layouts of rosbag2's older and newer storage versions.
TEST_F(RecordingTest, RecordingsOfAllSchemaVersionsAreRead) {
  const std::string rows = "INSERT INTO messages VALUES (1, 7, 5, x'00');";
  const std::string messages =
      "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
      " timestamp INTEGER NOT NULL, data BLOB NOT NULL);";
  run_sql(path("v1.db3"),
          "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
          " serialization_format TEXT NOT NULL); INSERT INTO topics VALUES (7, 'a', 'b', 'cdr');" +
              messages + rows);
  run_sql(path("v4.db3"),
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
  std::ofstream(path("there.db3")) << "precious";
  EXPECT_EQ(Recorder::create(path("there.db3")).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(test::slurp(path("there.db3")), "precious");
  EXPECT_FALSE(Recorder::create(path("no/such/a.db3")));
  EXPECT_FALSE(Recorder::create(path("no/such/folder")));
  auto recorder = Recorder::create(path("a.db3"));
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
      auto recorder = Recorder::create(bag + "/bag_" + std::to_string(file) + suffix);
      ASSERT_TRUE(recorder && recorder->add_topic({"of " + std::to_string(file % 2), "t", "f"}));
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
    auto recorder = Recorder::create(path("a.db3"));
    ASSERT_TRUE(recorder && recorder->add_topic({"a", "t", "f"}));
    for (int i = 0; i < 1000; ++i) ASSERT_TRUE(recorder->write(0, i, bytes("x")));
  }
  EXPECT_EQ(Recording::open(path("a.db3"))->num_messages(), 1000u);
}

TEST_F(RecordingTest, MessageBeyondTheLimitIsRefused) {
  ASSERT_TRUE(record_two(path("a.db3")));
  run_sql(path("a.db3"), "UPDATE messages SET data = zeroblob(" +
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
  ASSERT_TRUE(record_two(path("a.db3")));
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

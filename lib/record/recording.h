// SPDX-License-Identifier: Apache-2.0
// Recorded inputs: SQLite files in the layout of rosbag2's sqlite3 storage (schema version 3), so that ROS 2
// tools open ours and we open theirs. Tables: schema, metadata, topics, messages; docs/formats.md.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>
#include <xauto/result.h>

struct sqlite3;
struct sqlite3_stmt;

namespace xauto::record {

inline constexpr std::size_t kMaxTopics = 4096;
inline constexpr std::size_t kMaxMessageBytes = 256u << 20;

struct Topic {
  std::string name, type, serialization_format;
};

struct Message {
  std::size_t topic = 0;  ///< index into topics()
  std::int64_t timestamp_ns = 0;
  std::vector<std::byte> data;
};

struct SqliteCloser {
  void operator()(sqlite3* database) const;
  void operator()(sqlite3_stmt* statement) const;
};
using Database = std::unique_ptr<sqlite3, SqliteCloser>;
using Statement = std::unique_ptr<sqlite3_stmt, SqliteCloser>;

/// Reads messages of all topics by ascending time stamp, in bounded memory. Threads: one.
class Recording {
 public:
  /// `path`: a .db3 file, or a rosbag2 folder that holds exactly one. kInvalid names what is wrong with it.
  [[nodiscard]] static Result<Recording> open(const std::string& path);

  [[nodiscard]] const std::vector<Topic>& topics() const { return topics_; }
  [[nodiscard]] std::uint64_t num_messages() const { return num_messages_; }
  /// nullopt at the end.
  [[nodiscard]] Result<std::optional<Message>> next();

 private:
  std::string path_;
  Database database_;
  Statement messages_;
  std::vector<Topic> topics_;
  std::vector<std::int64_t> topic_ids_;
  std::uint64_t num_messages_ = 0;
};

/// Writes one. Messages are committed in batches and on close. Threads: one.
class Recorder {
 public:
  /// Refuses to overwrite an existing file.
  [[nodiscard]] static Result<Recorder> create(const std::string& path);
  Recorder(Recorder&&) noexcept = default;
  Recorder& operator=(Recorder&&) noexcept = default;
  ~Recorder();

  [[nodiscard]] Result<std::size_t> add_topic(const Topic& topic);
  [[nodiscard]] Status write(std::size_t topic, std::int64_t timestamp_ns,
                             std::span<const std::byte> data);
  /// Commits; an error means that the last batch is not in the file.
  [[nodiscard]] Status close();

 private:
  Recorder() = default;
  std::string path_;
  Database database_;
  Statement insert_;
  std::size_t num_topics_ = 0, uncommitted_ = 0;
};

}  // namespace xauto::record

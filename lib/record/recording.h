// SPDX-License-Identifier: Apache-2.0
// Recorded inputs: SQLite files in the layout of rosbag2's sqlite3 storage (schema version 3), so
// that ROS 2 tools open ours and we open theirs. Tables: schema, metadata, topics, messages;
// docs/formats.md. Reading (recording.cc) trusts nothing in the file; writing is recorder.cc.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"

struct sqlite3;
struct sqlite3_stmt;

namespace xauto::record {

inline constexpr std::size_t kMaxTopics = 4096;
inline constexpr std::size_t kMaxTopicTextBytes = 64u << 10;  ///< a name, a type, a format
inline constexpr std::size_t kMaxMessageBytes = 64u << 20;
/// 2100-01-01: a time stamp beyond it is a mistake of unit or a damaged file.
inline constexpr std::int64_t kMaxTimestampNs = 4'102'444'800'000'000'000;

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

/// Reads messages of all topics by ascending time stamp, then in the order they were written; holds
/// one message at a time. Threads: one.
class Recording {
 public:
  /// `path`: a .db3 file, or a rosbag2 folder that holds exactly one. kInvalid names what is wrong
  /// with it.
  [[nodiscard]] static Result<Recording> open(const std::string& path);

  [[nodiscard]] const std::vector<Topic>& topics() const { return topics_; }
  [[nodiscard]] std::uint64_t num_messages() const { return num_messages_; }
  /// nullopt at the end. What is wrong with one message is found here, not by open().
  [[nodiscard]] Result<std::optional<Message>> next();

 private:
  Recording() = default;
  [[nodiscard]] Result<Statement> prepare(const char* sql) const;
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const;
  [[nodiscard]] tl::unexpected<Error> damaged() const;  ///< with SQLite's last error
  [[nodiscard]] Status check_layout() const;
  [[nodiscard]] Status read_topics();
  [[nodiscard]] Status count_messages(std::uint64_t file_bytes);

  std::string path_;
  OneThread thread_;
  /// Steps of SQLite's machine left: pages that refer to each other in circles must not hang us.
  std::unique_ptr<std::int64_t> budget_;
  Database database_;
  Statement order_;  ///< rows by time
  Statement data_;   ///< the blob of one row, so that sorting never moves blobs
  std::vector<Topic> topics_;
  std::vector<std::int64_t> topic_ids_;
  std::uint64_t num_messages_ = 0, num_read_ = 0;
  std::int64_t last_ns_ = 0;
  bool finished_ = false;
};

/// Writes one. Messages are committed in batches and on close. Threads: one at a time.
class Recorder {
 public:
  /// The next thread that calls is another one; the caller orders the two.
  void give_away() { thread_.give_away(); }
  /// "x.db3": that file alone. Any other path: a rosbag2 folder with x_0.db3 and metadata.yaml.
  /// Refuses to overwrite.
  [[nodiscard]] static Result<Recorder> create(const std::string& path);
  Recorder(Recorder&&) noexcept = default;
  Recorder& operator=(Recorder&&) noexcept = default;
  ~Recorder();

  /// Index for write(). Names are unique.
  [[nodiscard]] Result<std::size_t> add_topic(const Topic& topic);
  [[nodiscard]] Status write(std::size_t topic, std::int64_t timestamp_ns,
                             std::span<const std::byte> data);
  /// Commits and writes the metadata; an error means that the last batch may not be in the file.
  [[nodiscard]] Status close();

 private:
  struct Written {
    Topic topic;
    std::uint64_t messages = 0;
  };
  Recorder() = default;
  [[nodiscard]] Status execute(const char* sql) const;
  [[nodiscard]] Status insert_metadata(const std::string& yaml) const;
  /// rosbag2's metadata (version 5), each line after `indent`.
  [[nodiscard]] std::string metadata(const std::string& indent) const;

  OneThread thread_;
  std::string path_;    ///< of the .db3
  std::string folder_;  ///< empty for a file alone
  Database database_;
  Statement insert_;
  std::vector<Written> topics_;
  std::size_t batch_messages_ = 0, batch_bytes_ = 0;
  std::uint64_t num_messages_ = 0;
  std::int64_t first_ns_ = 0, last_ns_ = 0;
};

}  // namespace xauto::record

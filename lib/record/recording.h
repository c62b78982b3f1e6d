// SPDX-License-Identifier: Apache-2.0
// Recorded inputs as ROS 2's rosbag2 has them, so that its tools open ours and we open theirs:
// files of MCAP or of SQLite, and folders of such files; docs/formats.md.
//
//   recording.cc (files merged by time)  ─► storage.h ─► mcap_reader.cc ─► mcap_layout.h, mcap_block.h
//   recorder.cc (folder, metadata.yaml)  ─┘        └───► sqlite_reader.cc
//                                                        mcap_writer.cc
//
// Reading trusts nothing in a file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"

namespace xauto::record {

inline constexpr std::size_t kMaxTopics = 4096;
inline constexpr std::size_t kMaxTopicTextBytes = 64u << 10;  ///< a name, a type, a format
inline constexpr std::size_t kMaxSchemaBytes = 1u << 20;
inline constexpr std::size_t kMaxMessageBytes = 64u << 20;
inline constexpr std::size_t kMaxFiles = 256;  ///< of a folder: all are open at once
/// 2100-01-01: a time stamp beyond it is a mistake of unit or a damaged file.
inline constexpr std::int64_t kMaxTimestampNs = 4'102'444'800'000'000'000;

/// No sensor of a vehicle is silent for so long: a clock was set while it was recorded, or a stamp is
/// wrong. Who replays it, waits as long.
inline constexpr std::int64_t kGapNs = 60'000'000'000;
/// "53.9 years without a message, from 1970-01-01 00:00:30.400 to 2023-11-14 22:13:20.000 UTC".
[[nodiscard]] std::string gap_text(std::int64_t from_ns, std::int64_t to_ns);

struct Topic {
  std::string name, type, serialization_format;
  /// What `type` means to who has never seen it: "ros2msg" and the .msg files' text, for example.
  /// Both empty: not known, or the storage is sqlite3, where it is not read.
  std::string schema_encoding = {}, schema = {};
};

struct Message {
  std::size_t topic = 0;  ///< index into topics()
  std::int64_t timestamp_ns = 0;
  std::vector<std::byte> data;
};

class Reader;
class Writer;

/// Reads messages of all topics by ascending time stamp, then in the order they were written. Holds
/// one message per file that overlaps another one in time; of MCAP also the chunks that do, at most
/// 512 MiB per file. Threads: one.
class Recording {
 public:
  /// `path`: a .mcap or .db3 file, or a folder that holds such files, of one kind. kInvalid names
  /// what is wrong with it. In a folder a file of which nothing can be read is left out and noted.
  [[nodiscard]] static Result<Recording> open(const std::string& path);
  Recording(Recording&&) noexcept;
  Recording& operator=(Recording&&) noexcept;
  ~Recording();

  [[nodiscard]] const std::vector<Topic>& topics() const { return topics_; }
  [[nodiscard]] std::uint64_t num_messages() const { return num_messages_; }
  /// nullopt at the end. What is wrong with one message is found here, not by open().
  [[nodiscard]] Result<std::optional<Message>> next();
  /// Why this is not all that was recorded, a line per file: its recorder died, it is damaged, it is not
  /// there. Empty: nothing says so.
  [[nodiscard]] const std::string& note() const { return note_; }
  /// Before the first next(): reads all files from end to end for the checksums of the whole. Those
  /// of a chunk are always checked.
  [[nodiscard]] Status verify();

 private:
  struct File;
  Recording() = default;
  [[nodiscard]] Status add(std::unique_ptr<Reader> reader, const std::string& path);
  void tell(const std::string& path, const std::string& what);
  [[nodiscard]] Status fetch(File& file);

  std::string path_;
  OneThread thread_;
  std::vector<std::unique_ptr<File>> files_;
  std::vector<Topic> topics_;
  std::unordered_map<std::string, std::size_t> topic_at_;  ///< by name
  std::uint64_t num_messages_ = 0;
  std::int64_t last_ns_ = 0;
  std::string note_;
};

/// Writes one. Threads: one at a time.
class Recorder {
 public:
  /// The next thread that calls is another one; the caller orders the two.
  void give_away() { thread_.give_away(); }
  /// "x.mcap": that file alone. "x.db3" is refused. Any other path: a rosbag2 folder with x_0.mcap and
  /// metadata.yaml. Refuses to overwrite.
  [[nodiscard]] static Result<Recorder> create(const std::string& path);
  Recorder(Recorder&&) noexcept;
  Recorder& operator=(Recorder&&) noexcept;
  ~Recorder();

  /// Index for write(). Names are unique.
  [[nodiscard]] Result<std::size_t> add_topic(const Topic& topic);
  [[nodiscard]] Status write(std::size_t topic, std::int64_t timestamp_ns,
                             std::span<const std::byte> data);
  /// What was written and added is in the file: whoever dies after it does not lose it.
  [[nodiscard]] Status flush();
  /// Writes what is left and the metadata; an error means that the last batch may not be there.
  [[nodiscard]] Status close();

 private:
  struct Written {
    Topic topic;
    std::uint64_t messages = 0;
  };
  Recorder() = default;
  /// rosbag2's metadata (version 5), each line after `indent`.
  [[nodiscard]] std::string metadata(const std::string& indent) const;

  OneThread thread_;
  std::string path_;                ///< of the file
  std::string folder_;              ///< empty for a file alone
  std::unique_ptr<Writer> writer_;  ///< null: closed
  std::vector<Written> topics_;
  std::uint64_t num_messages_ = 0;
  std::int64_t first_ns_ = 0, last_ns_ = 0;
};

}  // namespace xauto::record

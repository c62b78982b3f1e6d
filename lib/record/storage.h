// SPDX-License-Identifier: Apache-2.0
// What a storage (sqlite3, mcap) does for Recording and Recorder, which check what is common to both.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "record/recording.h"

namespace xauto::record {

/// rosbag2's metadata of ROS 2 Humble, which everything since reads.
inline constexpr int kMetadataVersion = 5;

/// One file; it trusts nothing in it. Threads: one.
class Reader {
 public:
  Reader() = default;
  virtual ~Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  [[nodiscard]] virtual const std::vector<Topic>& topics() const = 0;
  [[nodiscard]] virtual std::uint64_t num_messages() const = 0;
  /// No message is earlier.
  [[nodiscard]] virtual Result<std::int64_t> start_ns() = 0;
  /// By ascending time stamp, then in the order they were written; nullopt at the end.
  [[nodiscard]] virtual Result<std::optional<Message>> next() = 0;
  /// See Recording.
  [[nodiscard]] virtual std::string note() const { return {}; }
  [[nodiscard]] virtual Status verify() { return {}; }
};

[[nodiscard]] Result<std::unique_ptr<Reader>> open_sqlite(const std::string& path);
/// Bytes of chunks, unpacked, and of the order of their messages, that are held at once.
inline constexpr std::uint64_t kMaxOpenBytes = 512u << 20;
[[nodiscard]] Result<std::unique_ptr<Reader>> open_mcap(
    const std::string& path, std::uint64_t max_open_bytes = kMaxOpenBytes);

/// One new file. Recorder has checked the arguments. Threads: one at a time.
class Writer {
 public:
  Writer() = default;
  virtual ~Writer() = default;
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Topics are numbered in the order in which they are added.
  [[nodiscard]] virtual Status add_topic(const Topic& topic) = 0;
  [[nodiscard]] virtual Status write(std::size_t topic, std::int64_t timestamp_ns,
                                     std::span<const std::byte> data) = 0;
  /// See Recorder.
  [[nodiscard]] virtual Status flush() = 0;
  /// Once, and last. `metadata`: rosbag2's, as YAML.
  [[nodiscard]] virtual Status close(const std::string& metadata) = 0;
};

[[nodiscard]] Result<std::unique_ptr<Writer>> create_mcap(const std::string& path);

/// The files of a recording, in their order, and what its metadata.yaml says.
struct Found {
  std::vector<std::string> files;
  bool folder = false;
  std::vector<std::string> named;             ///< by metadata.yaml
  std::optional<std::uint64_t> num_messages;  ///< likewise, of all files
};
[[nodiscard]] Result<Found> find_files(const std::string& path);

/// A name of a file in a message: quoted, cut, printable.
[[nodiscard]] std::string shown(std::string text);

}  // namespace xauto::record

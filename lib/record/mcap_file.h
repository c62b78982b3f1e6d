// SPDX-License-Identifier: Apache-2.0
// The bytes of an MCAP file, and its blocks: what is read, unpacked and checked at once.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "record/mcap_format.h"
#include "record/recording.h"

namespace xauto::record::mcap {

/// Threads: one.
class File {
 public:
  [[nodiscard]] Status open(const std::string& path);
  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] std::uint64_t size() const { return size_; }
  /// All of `into`, which lies within the file's size.
  [[nodiscard]] Status read(std::uint64_t offset, std::span<std::byte> into) const;
  /// So many bytes, at most kWindowBytes, or up to the file's end; until the next call.
  [[nodiscard]] Result<std::span<const std::byte>> look(std::uint64_t offset, std::size_t bytes);
  /// kInvalid, at this file: it is damaged there.
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const;

  static constexpr std::size_t kWindowBytes = 64u << 10;

 private:
  OneThread thread_;
  UniqueFd fd_;
  std::string path_;
  std::uint64_t size_ = 0;
  std::vector<std::byte> window_;  ///< the file's bytes from window_at_ on
  std::uint64_t window_at_ = 0;
};

/// What Schema and Channel records have said.
class Channels {
 public:
  /// A second record of an id must be as the first.
  [[nodiscard]] Status add(const File& file, Op op, std::span<const std::byte> content,
                           std::uint64_t offset);
  /// From here on a new channel is a fault: topics() has been told.
  [[nodiscard]] Status close(const File& file);
  [[nodiscard]] bool known(std::uint16_t channel) const { return channels_.contains(channel); }
  /// Nullopt: there is no such channel.
  [[nodiscard]] std::optional<Topic> topic(std::uint16_t channel) const;
  [[nodiscard]] std::size_t size() const { return channels_.size(); }
  /// Of a known one, after close().
  [[nodiscard]] std::size_t topic_of(std::uint16_t channel) const {
    return topic_of_.find(channel)->second;
  }
  [[nodiscard]] const std::vector<Topic>& topics() const { return topics_; }

 private:
  bool closed_ = false;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  std::map<std::uint16_t, std::size_t> topic_of_;
  std::vector<Topic> topics_;
};

/// A Chunk, or Messages that follow each other outside of chunks (with Schemas and Channels).
struct Block {
  std::uint64_t offset = 0;       ///< of its first record
  std::uint64_t data_offset = 0;  ///< of what is read
  std::uint64_t data_bytes = 0;   ///< in the file
  std::uint64_t bytes = 0;        ///< unpacked
  std::int64_t start_ns = 0, end_ns = 0;
  std::uint32_t crc = 0;  ///< 0: none
  Compression compression = Compression::kNone;
  bool chunk = false;

  [[nodiscard]] std::string name() const;  ///< for messages
};

/// A message of a block.
struct Entry {
  std::int64_t timestamp_ns = 0;
  std::uint32_t offset = 0;  ///< of its record
};

struct Loaded {
  std::unique_ptr<std::byte[]> data;
  std::vector<Entry> entries;  ///< as they were written
};

/// All bytes of a block, unpacked; kInvalid: not those that were written.
[[nodiscard]] Result<std::unique_ptr<std::byte[]>> unpack(const File& file, const Block& block);
/// Reads, unpacks and checks all of a block; adds its channels.
[[nodiscard]] Result<Loaded> load(const File& file, const Block& block, Channels& channels);

/// A log time as we have it, or what is wrong with it.
[[nodiscard]] Result<std::int64_t> timestamp(const File& file, std::uint64_t time,
                                             const std::string& where);

}  // namespace xauto::record::mcap

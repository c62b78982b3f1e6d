// SPDX-License-Identifier: Apache-2.0
// MCAP: its records, their limits here, and their bytes. The format is https://mcap.dev/spec:
//
//   magic, Header, data section, DataEnd, summary section, summary offset section, Footer, magic
//
// Each record is an opcode, a length of 8 bytes, and its content; numbers are little-endian. The data
// section has Schemas, Channels and Messages, in Chunks (compressed) or without. The summary repeats
// Schemas and Channels, and says where Chunks are.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <xauto/result.h>

namespace xauto::record::mcap {

inline constexpr std::string_view kMagic = "\x89MCAP0\r\n";

enum class Op : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kAttachment = 0x09,
  kAttachmentIndex = 0x0a,
  kStatistics = 0x0b,
  kMetadata = 0x0c,
  kMetadataIndex = 0x0d,
  kSummaryOffset = 0x0e,
  kDataEnd = 0x0f,
};

inline constexpr std::size_t kRecordHead = 1 + 8;
inline constexpr std::size_t kMessageHead = 2 + 4 + 8 + 8;  ///< of its content, before the data
inline constexpr std::size_t kFooterBytes = 8 + 8 + 4;
/// Footer and magic: what a file that was closed ends with.
inline constexpr std::size_t kTailBytes = kRecordHead + kFooterBytes + kMagic.size();

// What we read; the format knows no limits. A chunk is held whole, and so is what overlaps it in time.
inline constexpr std::uint64_t kMaxChunkBytes = 256u << 20;
inline constexpr std::uint64_t kMaxSummaryBytes = 256u << 20;
inline constexpr std::uint64_t kMaxRecordBytes = 2u << 20;  ///< Header, Schema, Channel, Statistics

/// Reads fields. Beyond the end all are 0 or empty, and `ok` says so.
class Cursor {
 public:
  explicit Cursor(std::span<const std::byte> bytes) : bytes_(bytes) {}

  [[nodiscard]] bool ok() const { return ok_; }
  [[nodiscard]] std::size_t left() const { return bytes_.size(); }
  std::uint8_t u8() { return static_cast<std::uint8_t>(number(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(number(2)); }
  std::uint32_t u32() { return static_cast<std::uint32_t>(number(4)); }
  std::uint64_t u64() { return number(8); }
  std::span<const std::byte> bytes(std::uint64_t count);
  /// A length of 4 bytes, and so many.
  std::span<const std::byte> sized() { return bytes(u32()); }
  std::string text();

 private:
  std::uint64_t number(int bytes);

  std::span<const std::byte> bytes_;
  bool ok_ = true;
};

/// Writes fields.
class Bytes {
 public:
  void u8(std::uint8_t value) { number(value, 1); }
  void u16(std::uint16_t value) { number(value, 2); }
  void u32(std::uint32_t value) { number(value, 4); }
  void u64(std::uint64_t value) { number(value, 8); }
  void bytes(std::span<const std::byte> data) { out_.insert(out_.end(), data.begin(), data.end()); }
  void sized(std::span<const std::byte> data);
  void text(std::string_view text);
  /// A record's opcode and length; its content follows.
  void head(Op op, std::uint64_t length);
  void record(Op op, const Bytes& content);

  [[nodiscard]] std::span<const std::byte> view() const { return out_; }
  [[nodiscard]] std::vector<std::byte> take() && { return std::move(out_); }
  [[nodiscard]] std::size_t size() const { return out_.size(); }
  void clear() { out_.clear(); }
  void reserve(std::size_t bytes) { out_.reserve(bytes); }

 private:
  void number(std::uint64_t value, int bytes);

  std::vector<std::byte> out_;
};

struct RecordHead {
  Op op{};
  std::uint64_t length = 0;  ///< of its content
};

struct Schema {
  std::uint16_t id = 0;  ///< 0 is no schema
  std::string name, encoding, data;
  [[nodiscard]] bool operator==(const Schema& other) const;
};

struct Channel {
  std::uint16_t id = 0, schema = 0;
  std::string topic, encoding;
  std::vector<std::pair<std::string, std::string>> metadata;
  [[nodiscard]] bool operator==(const Channel& other) const;
};

/// Of a Chunk all but its records.
struct ChunkHead {
  std::uint64_t start = 0, end = 0;  ///< log times
  std::uint64_t uncompressed_bytes = 0;
  std::uint32_t uncompressed_crc = 0;  ///< 0: none
  std::string compression;
  std::uint64_t bytes = 0;  ///< of the records, as they are in the file
};
inline constexpr std::size_t kChunkFixedBytes = 8 + 8 + 8 + 4 + 4 + 8;
inline constexpr std::size_t kMaxCompressionName = 32;

struct ChunkIndex {
  std::uint64_t start = 0, end = 0;
  std::uint64_t offset = 0, length = 0;  ///< of the Chunk record, with its head
  std::vector<std::pair<std::uint16_t, std::uint64_t>> message_indexes;  ///< channel, offset
  std::uint64_t message_index_bytes = 0;
  std::string compression;
  std::uint64_t compressed_bytes = 0, uncompressed_bytes = 0;
};

struct Statistics {
  std::uint64_t messages = 0;
  std::uint16_t schemas = 0;
  std::uint32_t channels = 0, attachments = 0, metadata = 0, chunks = 0;
  std::uint64_t start = 0, end = 0;
  std::vector<std::pair<std::uint16_t, std::uint64_t>> per_channel;
};

struct Footer {
  std::uint64_t summary_start = 0, summary_offset_start = 0;  ///< 0: there is none
  std::uint32_t summary_crc = 0;                              ///< 0: none
};

// nullopt: the content is shorter than its fields say. Fields behind those that we know are ignored.
[[nodiscard]] std::optional<Schema> parse_schema(std::span<const std::byte> content);
[[nodiscard]] std::optional<Channel> parse_channel(std::span<const std::byte> content);
/// `content`: as much of the record's beginning as there is at hand.
[[nodiscard]] std::optional<ChunkHead> parse_chunk_head(std::span<const std::byte> content);
[[nodiscard]] std::optional<ChunkIndex> parse_chunk_index(std::span<const std::byte> content);
[[nodiscard]] std::optional<Statistics> parse_statistics(std::span<const std::byte> content);

void put(Bytes& out, const Schema& schema);
void put(Bytes& out, const Channel& channel);
void put(Bytes& out, const ChunkHead& chunk);  ///< head and all, but for the records themselves
void put(Bytes& out, const ChunkIndex& index);
void put(Bytes& out, const Statistics& statistics);

/// zlib's, as MCAP's is; `crc`: of what came before.
[[nodiscard]] std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t crc = 0);

enum class Compression : std::uint8_t { kNone, kLz4, kZstd };
/// nullopt: not one of the format's.
[[nodiscard]] std::optional<Compression> compression_of(std::string_view name);
/// Fills `out`; false: `in` is not just so much.
[[nodiscard]] bool decompress(Compression compression, std::span<const std::byte> in,
                              std::span<std::byte> out);

/// "record 0x06 at byte 1234": for messages.
[[nodiscard]] std::string record_at(Op op, std::uint64_t offset);

}  // namespace xauto::record::mcap

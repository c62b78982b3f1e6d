// SPDX-License-Identifier: Apache-2.0
#include "record/mcap_format.h"

#include <algorithm>
#include <cstdio>
#include <limits>
#include <memory>

#include <lz4frame.h>
#include <zlib.h>
#include <zstd.h>

namespace xauto::record::mcap {

std::uint64_t Cursor::number(int bytes) {
  const std::span<const std::byte> field = this->bytes(static_cast<std::uint64_t>(bytes));
  std::uint64_t value = 0;
  for (std::size_t i = field.size(); i > 0; --i)
    value = value << 8 | std::to_integer<std::uint64_t>(field[i - 1]);
  return value;
}

std::span<const std::byte> Cursor::bytes(std::uint64_t count) {
  if (count > bytes_.size()) {
    ok_ = false;
    bytes_ = {};
    return {};
  }
  const auto taken = bytes_.first(static_cast<std::size_t>(count));
  bytes_ = bytes_.subspan(static_cast<std::size_t>(count));
  return taken;
}

std::string Cursor::text() {
  const std::span<const std::byte> field = sized();
  return {reinterpret_cast<const char*>(field.data()), field.size()};
}

void Bytes::number(std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out_.push_back(static_cast<std::byte>(value >> (8 * i)));
}

void Bytes::sized(std::span<const std::byte> data) {
  u32(static_cast<std::uint32_t>(data.size()));
  bytes(data);
}

void Bytes::text(std::string_view text) {
  sized(std::as_bytes(std::span(text.data(), text.size())));
}

void Bytes::head(Op op, std::uint64_t length) {
  u8(static_cast<std::uint8_t>(op));
  u64(length);
}

void Bytes::record(Op op, const Bytes& content) {
  head(op, content.size());
  bytes(content.view());
}

bool Schema::operator==(const Schema& other) const {
  return id == other.id && name == other.name && encoding == other.encoding && data == other.data;
}

bool Channel::operator==(const Channel& other) const {
  return id == other.id && schema == other.schema && topic == other.topic &&
         encoding == other.encoding && metadata == other.metadata;
}

std::optional<Schema> parse_schema(std::span<const std::byte> content) {
  Cursor in(content);
  Schema s;
  s.id = in.u16();
  s.name = in.text();
  s.encoding = in.text();
  s.data = in.text();
  if (!in.ok()) return std::nullopt;
  return s;
}

std::optional<Channel> parse_channel(std::span<const std::byte> content) {
  Cursor in(content);
  Channel c;
  c.id = in.u16();
  c.schema = in.u16();
  c.topic = in.text();
  c.encoding = in.text();
  Cursor map(in.sized());
  while (in.ok() && map.ok() && map.left() > 0) {
    std::string key = map.text();
    c.metadata.emplace_back(std::move(key), map.text());
  }
  if (!in.ok() || !map.ok()) return std::nullopt;
  std::sort(c.metadata.begin(), c.metadata.end());  // a map has no order
  return c;
}

std::optional<ChunkHead> parse_chunk_head(std::span<const std::byte> content) {
  Cursor in(content);
  ChunkHead c;
  c.start = in.u64();
  c.end = in.u64();
  c.uncompressed_bytes = in.u64();
  c.uncompressed_crc = in.u32();
  c.compression = in.text();
  c.bytes = in.u64();
  if (!in.ok()) return std::nullopt;
  return c;
}

namespace {

std::vector<std::pair<std::uint16_t, std::uint64_t>> numbers_by_channel(Cursor& in) {
  std::vector<std::pair<std::uint16_t, std::uint64_t>> map;
  Cursor entries(in.sized());
  while (entries.left() > 0 && entries.ok()) {
    const std::uint16_t channel = entries.u16();
    map.emplace_back(channel, entries.u64());
  }
  if (!entries.ok()) (void)in.bytes(std::numeric_limits<std::uint64_t>::max());  // no longer ok
  return map;
}

void put_numbers_by_channel(Bytes& out,
                            const std::vector<std::pair<std::uint16_t, std::uint64_t>>& map) {
  out.u32(static_cast<std::uint32_t>(map.size() * (2 + 8)));
  for (const auto& [channel, number] : map) {
    out.u16(channel);
    out.u64(number);
  }
}

}  // namespace

std::optional<ChunkIndex> parse_chunk_index(std::span<const std::byte> content) {
  Cursor in(content);
  ChunkIndex c;
  c.start = in.u64();
  c.end = in.u64();
  c.offset = in.u64();
  c.length = in.u64();
  c.message_indexes = numbers_by_channel(in);
  c.message_index_bytes = in.u64();
  c.compression = in.text();
  c.compressed_bytes = in.u64();
  c.uncompressed_bytes = in.u64();
  if (!in.ok()) return std::nullopt;
  return c;
}

std::optional<Statistics> parse_statistics(std::span<const std::byte> content) {
  Cursor in(content);
  Statistics s;
  s.messages = in.u64();
  s.schemas = in.u16();
  s.channels = in.u32();
  s.attachments = in.u32();
  s.metadata = in.u32();
  s.chunks = in.u32();
  s.start = in.u64();
  s.end = in.u64();
  s.per_channel = numbers_by_channel(in);
  if (!in.ok()) return std::nullopt;
  return s;
}

void put(Bytes& out, const Schema& schema) {
  Bytes content;
  content.u16(schema.id);
  content.text(schema.name);
  content.text(schema.encoding);
  content.text(schema.data);
  out.record(Op::kSchema, content);
}

void put(Bytes& out, const Channel& channel) {
  Bytes map, content;
  for (const auto& [key, value] : channel.metadata) {
    map.text(key);
    map.text(value);
  }
  content.u16(channel.id);
  content.u16(channel.schema);
  content.text(channel.topic);
  content.text(channel.encoding);
  content.sized(map.view());
  out.record(Op::kChannel, content);
}

void put(Bytes& out, const ChunkHead& chunk) {
  out.head(Op::kChunk, kChunkFixedBytes + chunk.compression.size() + chunk.bytes);
  out.u64(chunk.start);
  out.u64(chunk.end);
  out.u64(chunk.uncompressed_bytes);
  out.u32(chunk.uncompressed_crc);
  out.text(chunk.compression);
  out.u64(chunk.bytes);
}

void put(Bytes& out, const ChunkIndex& index) {
  Bytes content;
  content.u64(index.start);
  content.u64(index.end);
  content.u64(index.offset);
  content.u64(index.length);
  put_numbers_by_channel(content, index.message_indexes);
  content.u64(index.message_index_bytes);
  content.text(index.compression);
  content.u64(index.compressed_bytes);
  content.u64(index.uncompressed_bytes);
  out.record(Op::kChunkIndex, content);
}

void put(Bytes& out, const Statistics& statistics) {
  Bytes content;
  content.u64(statistics.messages);
  content.u16(statistics.schemas);
  content.u32(statistics.channels);
  content.u32(statistics.attachments);
  content.u32(statistics.metadata);
  content.u32(statistics.chunks);
  content.u64(statistics.start);
  content.u64(statistics.end);
  put_numbers_by_channel(content, statistics.per_channel);
  out.record(Op::kStatistics, content);
}

std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t crc) {
  return static_cast<std::uint32_t>(
      crc32_z(crc, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

std::optional<Compression> compression_of(std::string_view name) {
  if (name.empty()) return Compression::kNone;
  if (name == "lz4") return Compression::kLz4;
  if (name == "zstd") return Compression::kZstd;
  return std::nullopt;
}

namespace {

/// One LZ4 frame: that is the whole of `in`, and `out` when it is unpacked.
bool unpack_lz4(std::span<const std::byte> in, std::span<std::byte> out) {
  LZ4F_dctx* raw = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&raw, LZ4F_VERSION)) != 0) return false;
  const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> context(
      raw, &LZ4F_freeDecompressionContext);
  for (;;) {
    std::size_t read = in.size(), written = out.size();
    const std::size_t more =
        LZ4F_decompress(context.get(), out.data(), &written, in.data(), &read, nullptr);
    if (LZ4F_isError(more) != 0) return false;
    in = in.subspan(read);
    out = out.subspan(written);
    if (more == 0) return in.empty() && out.empty();
    if (read == 0 && written == 0) return false;  // it wants more of either
  }
}

}  // namespace

bool decompress(Compression compression, std::span<const std::byte> in, std::span<std::byte> out) {
  switch (compression) {
    case Compression::kNone:
      if (in.size() != out.size()) return false;
      std::copy(in.begin(), in.end(), out.begin());
      return true;
    case Compression::kLz4:
      return unpack_lz4(in, out);
    case Compression::kZstd:
      return ZSTD_decompress(out.data(), out.size(), in.data(), in.size()) == out.size();
  }
  return false;
}

std::string record_at(Op op, std::uint64_t offset) {
  char text[48];
  std::snprintf(text, sizeof text, "record 0x%02x at byte %llu", static_cast<unsigned>(op),
                static_cast<unsigned long long>(offset));
  return text;
}

}  // namespace xauto::record::mcap

// SPDX-License-Identifier: Apache-2.0
#include "record/mcap_layout.h"

#include <algorithm>
#include <cstring>

#include "record/storage.h"

namespace xauto::record::mcap {
namespace {

/// Of messages outside of chunks: so many bytes are one block.
constexpr std::uint64_t kRunBytes = 1u << 20;

/// What the summary says of the file; checked against what the walk finds.
struct Summary {
  std::optional<Statistics> statistics;
  std::vector<ChunkIndex> chunks;
};

class Walk {
 public:
  explicit Walk(File& file) : file_(file) {}

  Result<Layout> run() {
    XAUTO_TRY(begin());
    XAUTO_TRY(read_end());
    // Whether the summary says which topics and how many messages there are.
    told_ = summary_.statistics && summary_.statistics->channels == layout_.channels.size();
    if (told_) XAUTO_TRY(layout_.channels.close(file_));
    const Status walked = walk();
    if (!walked && (closed_ || walked.error().code != ErrorCode::kInvalid))
      return tl::unexpected<Error>(walked.error());
    if (!closed_)
      layout_.damage = "its recorder did not close it: read up to byte " + std::to_string(at_) +
                       " of " + std::to_string(file_.size()) +
                       (walked ? "" : ", where " + walked.error().what);
    XAUTO_TRY(compare());
    if (!told_) XAUTO_TRY(layout_.channels.close(file_));
    return std::move(layout_);
  }

 private:
  Status begin() {
    XAUTO_ASSIGN(const auto magic, file_.look(0, kMagic.size()));
    if (magic.size() < kMagic.size() ||
        std::memcmp(magic.data(), kMagic.data(), kMagic.size()) != 0)
      return file_.broken(file_.size() == 0 ? "is empty" : "is not an MCAP file");
    at_ = kMagic.size();
    return {};
  }

  /// Footer and summary, if the file was closed.
  Status read_end() {
    end_ = file_.size();
    if (file_.size() < kMagic.size() + kTailBytes) return {};
    XAUTO_ASSIGN(const auto tail, file_.look(file_.size() - kTailBytes, kTailBytes));
    Cursor in(tail);
    const auto op = static_cast<Op>(in.u8());
    const std::uint64_t length = in.u64();
    Footer footer;
    footer.summary_start = in.u64();
    footer.summary_offset_start = in.u64();
    footer.summary_crc = in.u32();
    if (std::memcmp(in.bytes(kMagic.size()).data(), kMagic.data(), kMagic.size()) != 0) return {};
    if (op != Op::kFooter || length != kFooterBytes)
      return file_.broken("is damaged: there is no Footer before its end");
    closed_ = true;
    end_ = file_.size() - kTailBytes;
    if (footer.summary_start != 0) return read_summary(footer);
    return {};
  }

  Status read_summary(const Footer& footer) {
    const std::uint64_t start = footer.summary_start;
    if (start < kMagic.size() || start > end_ ||
        (footer.summary_offset_start != 0 &&
         (footer.summary_offset_start < start || footer.summary_offset_start > end_)))
      return file_.broken("is damaged: its Footer has the summary at byte " +
                          std::to_string(start));
    if (end_ - start > kMaxSummaryBytes)
      return file_.broken("its summary is longer than " + std::to_string(kMaxSummaryBytes) +
                          " bytes");
    // With the Footer up to the checksum, which covers it.
    std::vector<std::byte> bytes(
        static_cast<std::size_t>(end_ - start + kRecordHead + kFooterBytes - 4));
    XAUTO_TRY(file_.read(start, bytes));
    if (footer.summary_crc != 0 && crc32(bytes) != footer.summary_crc)
      return file_.broken("its summary is damaged: its checksum is wrong");
    Cursor in(std::span<const std::byte>(bytes).first(static_cast<std::size_t>(end_ - start)));
    summary_start_ = start;
    while (in.left() > 0) {
      const std::uint64_t offset = end_ - in.left();
      const auto op = static_cast<Op>(in.u8());
      const std::uint64_t length = in.u64();
      const std::span<const std::byte> content = in.bytes(length);
      if (!in.ok()) return file_.broken("its summary ends in the middle of a record");
      XAUTO_TRY(take_summary(op, content, offset));
    }
    return {};
  }

  Status take_summary(Op op, std::span<const std::byte> content, std::uint64_t offset) {
    switch (op) {
      case Op::kSchema:
      case Op::kChannel:
        return layout_.channels.add(file_, op, content, offset);
      case Op::kStatistics:
        summary_.statistics = parse_statistics(content);
        if (!summary_.statistics) return file_.broken(record_at(op, offset) + " is no Statistics");
        return {};
      case Op::kChunkIndex: {
        auto index = parse_chunk_index(content);
        if (!index) return file_.broken(record_at(op, offset) + " is no ChunkIndex");
        summary_.chunks.push_back(std::move(*index));
        return {};
      }
      case Op::kAttachmentIndex:
      case Op::kMetadataIndex:
      case Op::kSummaryOffset:
        return {};  // of what we do not read, or find by ourselves
      default:
        if (op <= Op::kDataEnd)
          return file_.broken(record_at(op, offset) + " does not belong into a summary");
        return {};
    }
  }

  Status walk() {
    bool first = true;
    while (at_ < end_) {
      XAUTO_ASSIGN(const auto head, file_.look(at_, kRecordHead));
      if (head.size() < kRecordHead) return file_.broken("it ends in the middle of a record");
      Cursor in(head);
      const auto op = static_cast<Op>(in.u8());
      const std::uint64_t length = in.u64();
      if (length > end_ - at_ - kRecordHead)
        return file_.broken(record_at(op, at_) + " is longer than what follows");
      if (first != (op == Op::kHeader))
        return file_.broken(record_at(op, at_) +
                            (first ? " stands before the Header" : " is a second Header"));
      XAUTO_TRY(take(op, length));
      if (op == Op::kDataEnd) {
        at_ += kRecordHead + length;
        if (closed_ && at_ != (summary_start_ != 0 ? summary_start_ : end_))
          return file_.broken("is damaged: between DataEnd and summary there is something else");
        // An unclosed file's summary is nothing that we need.
        return {};
      }
      first = false;
      at_ += kRecordHead + length;
    }
    if (closed_ && summary_start_ != 0) return file_.broken("has a summary, and no DataEnd");
    return {};
  }

  Status take(Op op, std::uint64_t length) {
    const std::string where = record_at(op, at_);
    if (op != Op::kMessage && op != Op::kSchema && op != Op::kChannel) run_ = nullptr;
    switch (op) {
      case Op::kHeader:
        if (length < 4 + 4 || length > kMaxRecordBytes)
          return file_.broken(where + " is no Header");
        return {};
      case Op::kSchema:
      case Op::kChannel:
        return take_small(op, length);
      case Op::kMessage:
        return take_message(length);
      case Op::kChunk:
        return take_chunk(length);
      case Op::kDataEnd: {
        XAUTO_ASSIGN(const auto content, file_.look(at_ + kRecordHead, 4));
        if (length < 4) return file_.broken(where + " is no DataEnd");
        layout_.data_end = at_;
        layout_.data_crc = Cursor(content).u32();
        return {};
      }
      case Op::kMessageIndex:
      case Op::kAttachment:
      case Op::kMetadata:
        return {};  // nothing that an app is fed with
      default:
        if (op <= Op::kDataEnd) return file_.broken(where + " does not belong there");
        return {};  // of a newer version, or somebody's own
    }
  }

  Status take_small(Op op, std::uint64_t length) {
    if (length > kMaxRecordBytes)
      return file_.broken(record_at(op, at_) + " is longer than " +
                          std::to_string(kMaxRecordBytes) + " bytes");
    std::vector<std::byte> content(static_cast<std::size_t>(length));
    XAUTO_TRY(file_.read(at_ + kRecordHead, content));
    return layout_.channels.add(file_, op, content, at_);
  }

  Status take_message(std::uint64_t length) {
    XAUTO_ASSIGN(const auto head, file_.look(at_ + kRecordHead, kMessageHead));
    const std::string where = record_at(Op::kMessage, at_);
    if (length < kMessageHead) return file_.broken(where + " is no Message");
    if (length - kMessageHead > kMaxMessageBytes)
      return file_.broken(where + ": data is longer than " + std::to_string(kMaxMessageBytes) +
                          " bytes");
    Cursor in(head);
    const std::uint16_t channel = in.u16();
    (void)in.u32();
    XAUTO_ASSIGN(const std::int64_t time, timestamp(file_, in.u64(), where));
    if (!layout_.channels.known(channel))
      return file_.broken(where + ": there is no channel " + std::to_string(channel));
    const std::uint64_t end = at_ + kRecordHead + length;
    if (run_ == nullptr || end - run_->offset > std::max(kRunBytes, kRecordHead + length)) {
      Block block;
      block.offset = block.data_offset = at_;
      block.start_ns = block.end_ns = time;
      layout_.blocks.push_back(block);
      run_ = &layout_.blocks.back();
    }
    run_->bytes = run_->data_bytes = end - run_->offset;
    run_->start_ns = std::min(run_->start_ns, time);
    run_->end_ns = std::max(run_->end_ns, time);
    ++layout_.num_messages;
    return {};
  }

  Status take_chunk(std::uint64_t length) {
    const std::string where = record_at(Op::kChunk, at_);
    XAUTO_ASSIGN(
        const auto content,
        file_.look(at_ + kRecordHead, static_cast<std::size_t>(std::min<std::uint64_t>(
                                          length, kChunkFixedBytes + kMaxCompressionName))));
    const auto chunk = parse_chunk_head(content);
    if (!chunk) return file_.broken(where + " is no Chunk");
    const std::uint64_t head = kChunkFixedBytes + chunk->compression.size();
    if (chunk->bytes > length - head)
      return file_.broken(where + ": its records are longer than it is");
    if (chunk->uncompressed_bytes > kMaxChunkBytes || chunk->bytes > kMaxChunkBytes)
      return file_.broken(where + ": its records are longer than " +
                          std::to_string(kMaxChunkBytes) + " bytes");
    const auto compression = compression_of(chunk->compression);
    if (!compression)
      return fail(ErrorCode::kInvalid,
                  where + ": compression " + shown(chunk->compression) + " is not known",
                  file_.path(), "the format has lz4 and zstd");
    if (*compression == Compression::kNone && chunk->bytes != chunk->uncompressed_bytes)
      return file_.broken(where + ": it is not compressed, and has two sizes");
    Block block;
    block.offset = at_;
    block.data_offset = at_ + kRecordHead + head;
    block.data_bytes = chunk->bytes;
    block.bytes = chunk->uncompressed_bytes;
    block.crc = chunk->uncompressed_crc;
    block.compression = *compression;
    block.chunk = true;
    XAUTO_ASSIGN(block.start_ns, timestamp(file_, chunk->start, where));
    XAUTO_ASSIGN(block.end_ns, timestamp(file_, chunk->end, where));
    if (!summary_.chunks.empty()) XAUTO_TRY(compare(block, kRecordHead + length));
    ++num_chunks_;
    if (!told_) {
      XAUTO_ASSIGN(const Loaded loaded, load(file_, block, layout_.channels));
      layout_.num_messages += loaded.entries.size();
      if (loaded.entries.empty()) return {};
    }
    layout_.blocks.push_back(block);
    return {};
  }

  /// With what the summary's ChunkIndex says.
  Status compare(const Block& block, std::uint64_t length) {
    if (num_chunks_ == 0)
      std::sort(summary_.chunks.begin(), summary_.chunks.end(),
                [](const ChunkIndex& a, const ChunkIndex& b) { return a.offset < b.offset; });
    if (num_chunks_ < summary_.chunks.size()) {
      const ChunkIndex& index = summary_.chunks[num_chunks_];
      if (index.offset == block.offset && index.length == length &&
          index.start == static_cast<std::uint64_t>(block.start_ns) &&
          index.end == static_cast<std::uint64_t>(block.end_ns) &&
          index.compressed_bytes == block.data_bytes && index.uncompressed_bytes == block.bytes)
        return {};
    }
    return file_.broken("is damaged: its index does not list " + block.name() + " as it is");
  }

  Status compare() {
    const auto& statistics = summary_.statistics;
    if (!summary_.chunks.empty() && summary_.chunks.size() != num_chunks_)
      return file_.broken("is damaged: its index lists " + std::to_string(summary_.chunks.size()) +
                          " chunks, there are " + std::to_string(num_chunks_));
    if (statistics && statistics->chunks != num_chunks_)
      return file_.broken("is damaged: its statistics count " + std::to_string(statistics->chunks) +
                          " chunks, there are " + std::to_string(num_chunks_));
    if (told_) layout_.num_messages = statistics->messages;
    return {};
  }

  File& file_;
  Layout layout_;
  Summary summary_;
  bool closed_ = false, told_ = false;
  std::uint64_t at_ = 0, end_ = 0, summary_start_ = 0;
  std::size_t num_chunks_ = 0;
  Block* run_ = nullptr;  ///< of messages outside of chunks, while they follow each other
};

}  // namespace

Result<Layout> find_layout(File& file) {
  return Walk(file).run();
}

}  // namespace xauto::record::mcap

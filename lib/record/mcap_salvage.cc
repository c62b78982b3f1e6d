// SPDX-License-Identifier: Apache-2.0
// From record to record, as the layout is found, but without belief in the summary. Where a record cannot be one, the
// next place that can be is sought: a Chunk whose lengths agree, or a Message of a known channel that another record
// follows.
#include <algorithm>
#include <cstring>

#include "record/mcap_file.h"
#include "record/salvage.h"
#include "record/storage.h"

namespace xauto::record {
namespace mcap {
namespace {

class Salvage {
 public:
  Salvage(File& file, const Take& take, Salvaged& out) : file_(file), take_(take), out_(out) {}

  Status run() {
    if (file_.size() == 0) return left_out("is empty");
    XAUTO_ASSIGN(const auto magic, file_.look(0, kMagic.size()));
    std::uint64_t at = kMagic.size();
    if (magic.size() < at || std::memcmp(magic.data(), kMagic.data(), at) != 0) {
      XAUTO_TRY(left_out("does not begin as an MCAP file"));
      XAUTO_ASSIGN(at, next_place(0));
    }
    while (at + kRecordHead <= file_.size()) {
      XAUTO_ASSIGN(const RecordHead head, head_at(at));
      if (!fits(at, head)) {
        XAUTO_TRY(left_out(record_at(head.op, at) + " is none, or longer than what follows"));
        const std::uint64_t broken = at;
        XAUTO_ASSIGN(at, next_place(at + 1));
        XAUTO_TRY(left_out("what follows byte " + std::to_string(broken) + " up to byte " +
                           std::to_string(at) + " cannot be read"));
        continue;
      }
      XAUTO_TRY(record(at, head));
      if (head.op == Op::kFooter) return {};
      at += kRecordHead + head.length;
    }
    return left_out("has no end: its recorder did not close it");
  }

 private:
  Status left_out(const std::string& what) {
    out_.leave_out(file_.path(), what);
    return {};
  }
  /// A fault of the file is left out; one of the machine ends it.
  Status left_out(const Error& error) {
    if (error.code != ErrorCode::kInvalid) return tl::unexpected<Error>(error);
    return left_out(error.what);
  }

  Result<RecordHead> head_at(std::uint64_t at) {
    XAUTO_ASSIGN(const auto bytes, file_.look(at, kRecordHead));
    Cursor in(bytes);
    RecordHead head;
    head.op = static_cast<Op>(in.u8());
    head.length = in.u64();
    return head;
  }

  [[nodiscard]] bool fits(std::uint64_t at, const RecordHead& head) const {
    return head.op != Op{} && head.length <= file_.size() - at - kRecordHead;
  }

  Status record(std::uint64_t at, const RecordHead& head) {
    switch (head.op) {
      case Op::kSchema:
      case Op::kChannel: {
        if (head.length > kMaxRecordBytes)
          return left_out(record_at(head.op, at) + " is longer than " +
                          std::to_string(kMaxRecordBytes) + " bytes");
        std::vector<std::byte> content(static_cast<std::size_t>(head.length));
        XAUTO_TRY(file_.read(at + kRecordHead, content));
        return channel(head.op, content, at);
      }
      case Op::kMessage: {
        if (head.length > kMaxMessageBytes + kMessageHead)
          return left_out(record_at(head.op, at) + ": data is longer than " +
                          std::to_string(kMaxMessageBytes) + " bytes");
        std::vector<std::byte> content(static_cast<std::size_t>(head.length));
        XAUTO_TRY(file_.read(at + kRecordHead, content));
        return message(content, record_at(head.op, at));
      }
      case Op::kChunk:
        return chunk(at, head);
      default:
        if (head.op > Op::kDataEnd)
          return left_out(record_at(head.op, at) + " is of no kind that is known: " +
                          std::to_string(head.length) + " bytes");
        return {};  // nothing that an app is fed with
    }
  }

  Status channel(Op op, std::span<const std::byte> content, std::uint64_t at) {
    const Status added = channels_.add(file_, op, content, at);
    return added ? Status() : left_out(added.error());
  }

  Status message(std::span<const std::byte> content, const std::string& where) {
    Cursor in(content);
    const std::uint16_t id = in.u16();
    (void)in.u32();  // sequence
    const std::uint64_t time = in.u64();
    (void)in.u64();  // publish_time
    if (!in.ok()) return left_out(where + " is no Message");
    if (in.left() > kMaxMessageBytes)
      return left_out(where + ": data is longer than " + std::to_string(kMaxMessageBytes) +
                      " bytes");
    const Result<std::int64_t> stamp = timestamp(file_, time, where);
    if (!stamp) return left_out(stamp.error());
    std::optional<Topic> topic = channels_.topic(id);
    if (!topic) {
      XAUTO_TRY(look_for_channels());
      topic = elsewhere_->topic(id);
    }
    if (!topic) return left_out(where + ": there is no channel " + std::to_string(id));
    XAUTO_TRY(take_(*topic, *stamp, content.subspan(kMessageHead)));
    ++out_.messages;
    return {};
  }

  /// Of the whole file, as far as records follow each other: the summary repeats what is damaged before.
  Status look_for_channels() {
    if (elsewhere_) return {};
    elsewhere_.emplace();
    for (std::uint64_t at = kMagic.size(); at + kRecordHead <= file_.size();) {
      XAUTO_ASSIGN(const RecordHead head, head_at(at));
      if (!fits(at, head)) return {};
      if ((head.op == Op::kSchema || head.op == Op::kChannel) && head.length <= kMaxRecordBytes) {
        std::vector<std::byte> content(static_cast<std::size_t>(head.length));
        XAUTO_TRY(file_.read(at + kRecordHead, content));
        (void)elsewhere_->add(file_, head.op, content,
                              at);  // what is wrong with it is told where it stands
      }
      at += kRecordHead + head.length;
    }
    return {};
  }

  /// Nullopt: its lengths contradict each other. `behind`: bytes of it that are no records; the format lets them be.
  Result<std::optional<Block>> block_at(std::uint64_t at, const RecordHead& record,
                                        std::uint64_t& behind) {
    XAUTO_ASSIGN(
        const auto bytes,
        file_.look(at + kRecordHead, static_cast<std::size_t>(std::min<std::uint64_t>(
                                         record.length, kChunkFixedBytes + kMaxCompressionName))));
    const auto head = parse_chunk_head(bytes);
    const auto compression = head ? compression_of(head->compression) : std::nullopt;
    if (!compression) return std::optional<Block>();
    Block block;
    const std::uint64_t before = kChunkFixedBytes + head->compression.size();
    block.chunk = true;
    block.offset = at;
    block.data_offset = at + kRecordHead + before;
    block.data_bytes = head->bytes;
    block.bytes = head->uncompressed_bytes;
    block.crc = head->uncompressed_crc;
    block.compression = *compression;
    const bool agrees = record.length >= before && head->bytes <= record.length - before &&
                        block.data_bytes <= kMaxChunkBytes && block.bytes <= kMaxChunkBytes &&
                        (block.compression != Compression::kNone || block.bytes == head->bytes);
    if (!agrees) return std::optional<Block>();
    behind = record.length - before - head->bytes;
    return std::optional<Block>(block);
  }

  Status chunk(std::uint64_t at, const RecordHead& record) {
    std::uint64_t behind = 0;
    XAUTO_ASSIGN(const auto block, block_at(at, record, behind));
    if (!block)
      return left_out(record_at(Op::kChunk, at) +
                      " is no Chunk, or of a compression that is not known: " +
                      std::to_string(record.length) + " bytes");
    if (behind > 0)
      XAUTO_TRY(left_out(record_at(Op::kChunk, at) + " has " + std::to_string(behind) +
                         " bytes behind its records"));
    const Result<std::unique_ptr<std::byte[]>> data = unpack(file_, *block);
    if (!data) return left_out(data.error());
    Cursor in({data->get(), static_cast<std::size_t>(block->bytes)});
    while (in.left() > 0) {
      const std::uint64_t offset = block->bytes - in.left();
      const auto op = static_cast<Op>(in.u8());
      const std::span<const std::byte> content = in.bytes(in.u64());
      const std::string where = block->name() + ": in it, " + record_at(op, offset);
      if (!in.ok())
        return left_out(where + " is longer than what follows: " +
                        std::to_string(block->bytes - offset) + " bytes");
      if (op == Op::kMessage)
        XAUTO_TRY(message(content, where));
      else if (op == Op::kSchema || op == Op::kChannel)
        XAUTO_TRY(channel(op, content, at));
      else
        XAUTO_TRY(left_out(where + " does not belong there"));
    }
    return {};
  }

  /// From `from` on the first place where a record can begin; the file's size where there is none.
  Result<std::uint64_t> next_place(std::uint64_t from) {
    for (std::uint64_t at = from; at + kRecordHead <= file_.size();) {
      XAUTO_ASSIGN(const auto window, file_.look(at, File::kWindowBytes));
      const auto begin = std::find_if(window.begin(), window.end(), [](std::byte b) {
        return static_cast<Op>(b) == Op::kChunk || static_cast<Op>(b) == Op::kMessage;
      });
      at += static_cast<std::uint64_t>(begin - window.begin());
      if (begin == window.end()) continue;
      if (at + kRecordHead > file_.size()) break;
      XAUTO_ASSIGN(const bool begins, begins_at(at));
      if (begins) return at;
      ++at;
    }
    return file_.size();
  }

  Result<bool> begins_at(std::uint64_t at) {
    XAUTO_ASSIGN(const RecordHead head, head_at(at));
    if (!fits(at, head)) return false;
    if (head.op == Op::kChunk) {
      std::uint64_t behind = 0;
      XAUTO_ASSIGN(const auto block, block_at(at, head, behind));
      return block.has_value() && behind == 0;  // a place that is sought has to be likely
    }
    if (head.length < kMessageHead || head.length > kMessageHead + kMaxMessageBytes) return false;
    XAUTO_ASSIGN(const auto content, file_.look(at + kRecordHead, kMessageHead));
    Cursor in(content);
    const std::uint16_t id = in.u16();
    (void)in.u32();
    if (in.u64() > static_cast<std::uint64_t>(kMaxTimestampNs) || !channels_.known(id))
      return false;
    const std::uint64_t next = at + kRecordHead + head.length;
    if (next + kRecordHead > file_.size()) return true;
    XAUTO_ASSIGN(const RecordHead follows, head_at(next));
    return fits(next, follows) && follows.op <= Op::kDataEnd;
  }

  File& file_;
  const Take& take_;
  Salvaged& out_;
  Channels channels_;
  std::optional<Channels> elsewhere_;  ///< looked for when a channel is missing
};

}  // namespace
}  // namespace mcap

Status salvage_mcap(const std::string& path, const Take& take, Salvaged& out) {
  mcap::File file;
  XAUTO_TRY(file.open(path));
  return mcap::Salvage(file, take, out).run();
}

}  // namespace xauto::record

// SPDX-License-Identifier: Apache-2.0
// Messages of an MCAP file by time. Blocks are ordered by their first message's time; one is loaded when
// that time has come, and let go with its last message. So those are held that overlap in time.
#include <algorithm>
#include <tuple>

#include "record/mcap_layout.h"
#include "record/storage.h"

namespace xauto::record {
namespace mcap {
namespace {

class McapReader final : public Reader {
 public:
  static Result<std::unique_ptr<Reader>> open(const std::string& path,
                                              std::uint64_t max_open_bytes);

  [[nodiscard]] const std::vector<Topic>& topics() const override {
    return layout_.channels.topics();
  }
  [[nodiscard]] std::uint64_t num_messages() const override { return layout_.num_messages; }
  [[nodiscard]] Result<std::int64_t> start_ns() override {
    return layout_.blocks.empty() ? 0 : layout_.blocks.front().start_ns;
  }
  [[nodiscard]] Result<std::optional<Message>> next() override;
  [[nodiscard]] std::string note() const override { return layout_.damage; }
  [[nodiscard]] Status verify() override;

 private:
  struct Open {
    std::uint64_t offset = 0;  ///< of the block
    std::uint64_t bytes = 0;   ///< of memory
    Loaded block;              ///< its entries by time
    std::size_t at = 0;        ///< the next entry

    [[nodiscard]] auto key() const {
      const Entry& entry = block.entries[at];
      return std::tuple(entry.timestamp_ns, offset, entry.offset);
    }
  };
  static bool later(const Open& a, const Open& b) { return a.key() > b.key(); }
  [[nodiscard]] Status open_block(const Block& block);
  [[nodiscard]] Message take(const Open& open) const;

  OneThread thread_;
  File file_;
  Layout layout_;
  std::size_t next_block_ = 0;
  std::vector<Open> open_;  ///< a heap: what comes next is on top
  std::uint64_t max_open_bytes_ = 0, open_bytes_ = 0;
  std::uint64_t num_read_ = 0;
};

Result<std::unique_ptr<Reader>> McapReader::open(const std::string& path,
                                                 std::uint64_t max_open_bytes) {
  auto r = std::make_unique<McapReader>();
  r->max_open_bytes_ = max_open_bytes;
  XAUTO_TRY(r->file_.open(path));
  XAUTO_ASSIGN(r->layout_, find_layout(r->file_));
  std::stable_sort(r->layout_.blocks.begin(), r->layout_.blocks.end(),
                   [](const Block& a, const Block& b) { return a.start_ns < b.start_ns; });
  return r;
}

Status McapReader::open_block(const Block& block) {
  Open open;
  open.offset = block.offset;
  XAUTO_ASSIGN(open.block, load(file_, block, layout_.channels));
  auto& entries = open.block.entries;
  if (entries.empty()) return {};
  entries.shrink_to_fit();
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::tie(a.timestamp_ns, a.offset) < std::tie(b.timestamp_ns, b.offset);
  });
  open.bytes = block.bytes + entries.size() * sizeof(Entry);
  open_bytes_ += open.bytes;
  if (open_bytes_ > max_open_bytes_)
    return fail(ErrorCode::kInvalid,
                "at " + block.name() + " more than " + std::to_string(max_open_bytes_) +
                    " bytes overlap in time",
                file_.path(), "`mcap sort` puts its messages in order");
  open_.push_back(std::move(open));
  std::push_heap(open_.begin(), open_.end(), later);
  return {};
}

Message McapReader::take(const Open& open) const {
  const std::byte* record = open.block.data.get() + open.block.entries[open.at].offset;
  Cursor head({record, kRecordHead + kMessageHead});
  (void)head.u8();
  const auto bytes = static_cast<std::size_t>(head.u64() - kMessageHead);
  Message message;
  message.topic = layout_.channels.topic_of(head.u16());
  message.timestamp_ns = open.block.entries[open.at].timestamp_ns;
  const std::byte* data = record + kRecordHead + kMessageHead;
  message.data.assign(data, data + bytes);
  return message;
}

Result<std::optional<Message>> McapReader::next() {
  thread_.check();
  const auto& blocks = layout_.blocks;
  while (next_block_ < blocks.size() &&
         (open_.empty() || blocks[next_block_].start_ns <= std::get<0>(open_.front().key())))
    XAUTO_TRY(open_block(blocks[next_block_++]));
  if (open_.empty() ? num_read_ != layout_.num_messages : num_read_ == layout_.num_messages)
    return file_.broken("is damaged: its statistics count " + std::to_string(layout_.num_messages) +
                        " messages, there are " +
                        (open_.empty() ? std::to_string(num_read_) : "more"));
  if (open_.empty()) return std::optional<Message>();
  std::pop_heap(open_.begin(), open_.end(), later);
  Open& first = open_.back();
  Message message = take(first);
  ++num_read_;
  if (++first.at == first.block.entries.size()) {
    open_bytes_ -= first.bytes;
    open_.pop_back();
  } else {
    std::push_heap(open_.begin(), open_.end(), later);
  }
  return std::optional<Message>(std::move(message));
}

Status McapReader::verify() {
  thread_.check();
  if (layout_.data_crc == 0) return {};
  std::vector<std::byte> part(1u << 20);
  std::uint32_t crc = 0;
  for (std::uint64_t at = 0; at < layout_.data_end; at += part.size()) {
    part.resize(
        static_cast<std::size_t>(std::min<std::uint64_t>(part.size(), layout_.data_end - at)));
    XAUTO_TRY(file_.read(at, part));
    crc = crc32(part, crc);
  }
  if (crc != layout_.data_crc)
    return file_.broken("is damaged: the checksum of its data section is wrong");
  return {};
}

}  // namespace
}  // namespace mcap

Result<std::unique_ptr<Reader>> open_mcap(const std::string& path, std::uint64_t max_open_bytes) {
  return mcap::McapReader::open(path, max_open_bytes);
}

}  // namespace xauto::record

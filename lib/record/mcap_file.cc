// SPDX-License-Identifier: Apache-2.0
#include "record/mcap_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>

#include "record/storage.h"

namespace xauto::record::mcap {

Status File::open(const std::string& path) {
  path_ = path;
  fd_.reset(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat status {};
  if (!fd_ || fstat(fd_.get(), &status) != 0)
    return fail(ErrorCode::kInvalid, std::string("cannot be opened: ") + std::strerror(errno),
                path);
  size_ = static_cast<std::uint64_t>(status.st_size);
  return {};
}

Status File::read(std::uint64_t offset, std::span<std::byte> into) const {
  while (!into.empty()) {
    const ssize_t got = ::pread(fd_.get(), into.data(), into.size(), static_cast<off_t>(offset));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0)
      return fail(ErrorCode::kIo, std::string("cannot be read: ") + std::strerror(errno), path_);
    if (got == 0) return fail(ErrorCode::kIo, "became shorter while it was read", path_);
    offset += static_cast<std::uint64_t>(got);
    into = into.subspan(static_cast<std::size_t>(got));
  }
  return {};
}

Result<std::span<const std::byte>> File::look(std::uint64_t offset, std::size_t bytes) {
  thread_.check();
  const std::uint64_t left = size_ - std::min(offset, size_);
  bytes = static_cast<std::size_t>(std::min<std::uint64_t>(bytes, left));
  if (offset < window_at_ || offset + bytes > window_at_ + window_.size()) {
    window_.resize(static_cast<std::size_t>(std::min<std::uint64_t>(kWindowBytes, left)));
    window_at_ = offset;
    XAUTO_TRY(read(offset, window_));
  }
  return std::span<const std::byte>(window_).subspan(static_cast<std::size_t>(offset - window_at_),
                                                     bytes);
}

tl::unexpected<Error> File::broken(const std::string& what) const {
  return fail(ErrorCode::kInvalid, what, path_);
}

Status Channels::add(const File& file, Op op, std::span<const std::byte> content,
                     std::uint64_t offset) {
  const std::string where = record_at(op, offset);
  if (content.size() > kMaxRecordBytes)
    return file.broken(where + " is longer than " + std::to_string(kMaxRecordBytes) + " bytes");
  if (op == Op::kSchema) {
    auto schema = parse_schema(content);
    if (!schema) return file.broken(where + " is no Schema");
    if (schema->id == 0) return {};  // to be ignored, says the specification
    if (schema->data.size() > kMaxSchemaBytes)
      return file.broken(where + ": its schema is longer than " + std::to_string(kMaxSchemaBytes) +
                         " bytes");
    const std::uint16_t id = schema->id;
    const auto [known, added] = schemas_.try_emplace(id, std::move(*schema));
    if (!added && !(known->second == *parse_schema(content)))
      return file.broken(where + ": schema " + std::to_string(id) + " was another one before");
    return {};
  }
  auto channel = parse_channel(content);
  if (!channel) return file.broken(where + " is no Channel");
  const std::uint16_t id = channel->id;
  if (const auto known = channels_.find(id); known != channels_.end()) {
    if (!(known->second == *channel))
      return file.broken(where + ": channel " + std::to_string(id) + " was another one before");
    return {};
  }
  if (closed_)
    return file.broken(where + ": channel " + std::to_string(id) + " is not in the summary");
  if (channel->topic.empty()) return file.broken("a topic has no name");
  if (channel->topic.size() > kMaxTopicTextBytes || channel->encoding.size() > kMaxTopicTextBytes)
    return file.broken(where + ": its topic or encoding is longer than " +
                       std::to_string(kMaxTopicTextBytes) + " bytes");
  if (channel->schema != 0 && !schemas_.contains(channel->schema))
    return file.broken(where + ": there is no schema " + std::to_string(channel->schema));
  if (channels_.size() >= kMaxTopics)
    return file.broken("has more than " + std::to_string(kMaxTopics) + " channels");
  channels_.emplace(id, std::move(*channel));
  return {};
}

std::optional<Topic> Channels::topic(std::uint16_t id) const {
  const auto found = channels_.find(id);
  if (found == channels_.end()) return std::nullopt;
  const Channel& channel = found->second;
  Topic topic{channel.topic, "", channel.encoding};
  if (channel.schema != 0) {
    const Schema& schema = schemas_.find(channel.schema)->second;
    topic.type = schema.name;
    topic.schema_encoding = schema.encoding;
    topic.schema = schema.data;
  }
  return topic;
}

Status Channels::close(const File& file) {
  closed_ = true;
  std::map<std::string, std::size_t> by_name;
  for (const auto& [id, channel] : channels_) {
    Topic topic = *this->topic(id);
    // Several channels may have one topic, of several publishers for example.
    const auto [at, added] = by_name.try_emplace(channel.topic, topics_.size());
    topic_of_.emplace(id, at->second);
    if (added) {
      topics_.push_back(std::move(topic));
      continue;
    }
    const Topic& same = topics_[at->second];
    if (same.type != topic.type || same.serialization_format != topic.serialization_format)
      return file.broken("topic " + shown(topic.name) + " has two types");
  }
  return {};
}

std::string Block::name() const {
  return (chunk ? "the chunk at byte " : "the messages from byte ") + std::to_string(offset) +
         (chunk ? "" : " on");
}

Result<std::int64_t> timestamp(const File& file, std::uint64_t time, const std::string& where) {
  if (time > static_cast<std::uint64_t>(kMaxTimestampNs))
    return file.broken(where + ": timestamp " + std::to_string(time) + " is not from 0 to " +
                       std::to_string(kMaxTimestampNs) + " ns");
  return static_cast<std::int64_t>(time);
}

namespace {

/// A Message in a block, checked.
Result<Entry> entry_of(const File& file, const Block& block, const Channels& channels,
                       std::span<const std::byte> content, std::size_t offset) {
  const auto where = [&] {
    return block.name() + ": " + (block.chunk ? "in it, " : "") +
           record_at(Op::kMessage, block.chunk ? offset : block.data_offset + offset);
  };
  Cursor in(content);
  const std::uint16_t channel = in.u16();
  (void)in.u32();  // sequence
  const std::uint64_t log_time = in.u64();
  (void)in.u64();  // publish_time
  if (!in.ok()) return file.broken(where() + " is no Message");
  if (in.left() > kMaxMessageBytes)
    return file.broken(where() + ": data is longer than " + std::to_string(kMaxMessageBytes) +
                       " bytes");
  if (!channels.known(channel))
    return file.broken(where() + ": there is no channel " + std::to_string(channel));
  Entry entry;
  entry.offset = static_cast<std::uint32_t>(offset);
  if (log_time > static_cast<std::uint64_t>(kMaxTimestampNs))
    return tl::unexpected<Error>(timestamp(file, log_time, where()).error());
  entry.timestamp_ns = static_cast<std::int64_t>(log_time);
  if (entry.timestamp_ns < block.start_ns || entry.timestamp_ns > block.end_ns)
    return file.broken(where() + " is not from the chunk's time");
  return entry;
}

}  // namespace

Result<std::unique_ptr<std::byte[]>> unpack(const File& file, const Block& block) {
  const auto size = static_cast<std::size_t>(block.bytes);
  std::unique_ptr<std::byte[]> bytes(new std::byte[size]);  // not zeroed: large, and is filled
  const std::span<std::byte> data(bytes.get(), size);
  if (block.compression == Compression::kNone) {
    XAUTO_TRY(file.read(block.data_offset, data));
  } else {
    const auto packed_size = static_cast<std::size_t>(block.data_bytes);
    const std::unique_ptr<std::byte[]> packed(new std::byte[packed_size]);
    XAUTO_TRY(file.read(block.data_offset, {packed.get(), packed_size}));
    if (!decompress(block.compression, {packed.get(), packed_size}, data))
      return file.broken(block.name() + " is damaged: it cannot be unpacked to " +
                         std::to_string(size) + " bytes");
  }
  if (block.crc != 0 && crc32(data) != block.crc)
    return file.broken(block.name() + " is damaged: its checksum is wrong");
  return bytes;
}

Result<Loaded> load(const File& file, const Block& block, Channels& channels) {
  const auto size = static_cast<std::size_t>(block.bytes);
  Loaded loaded;
  XAUTO_ASSIGN(loaded.data, unpack(file, block));
  Cursor in({loaded.data.get(), size});
  while (in.left() > 0) {
    const std::size_t offset = size - in.left();
    const auto op = static_cast<Op>(in.u8());
    const std::uint64_t length = in.u64();
    const std::span<const std::byte> content = in.bytes(length);
    if (!in.ok()) return file.broken(block.name() + " ends in the middle of a record");
    switch (op) {
      case Op::kSchema:
      case Op::kChannel:
        XAUTO_TRY(channels.add(file, op, content, block.offset));
        break;
      case Op::kMessage: {
        XAUTO_ASSIGN(const Entry entry, entry_of(file, block, channels, content, offset));
        loaded.entries.push_back(entry);
        break;
      }
      default:
        if (op <= Op::kDataEnd)
          return file.broken(block.name() + " holds a record 0x0" +
                             std::to_string(static_cast<int>(op)) + " that belongs elsewhere");
        break;  // of a newer version, or somebody's own
    }
  }
  return loaded;
}

}  // namespace xauto::record::mcap

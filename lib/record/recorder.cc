// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "record/recording.h"
#include "record/storage.h"

namespace xauto::record {
namespace {

/// A YAML double-quoted text.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (byte < 0x20 || byte == 0x7f) {
      char escape[8];
      std::snprintf(escape, sizeof escape, "\\x%02x", byte);
      out += escape;
    } else {
      out += c;
    }
  }
  return out + '"';
}

}  // namespace

Recorder::Recorder(Recorder&&) noexcept = default;
Recorder& Recorder::operator=(Recorder&&) noexcept = default;

Recorder::~Recorder() {
  if (writer_) (void)close();
}

Result<Recorder> Recorder::create(const std::string& given) {
  namespace fs = std::filesystem;
  fs::path path = given;
  if (!path.has_filename()) path = path.parent_path();  // "drive/"
  std::error_code error;
  if (fs::exists(path, error))
    return fail(ErrorCode::kInvalid, "exists already", given, "record under a new name");
  if (path.extension() == ".db3")
    return fail(ErrorCode::kInvalid, "SQLite is read and not written", given,
                "a name that ends in .mcap, or a folder");
  Recorder r;
  r.path_ = path.string();
  if (path.extension() != ".mcap") {
    if (!fs::create_directory(path, error))
      return fail(ErrorCode::kNotFound, "cannot be created: " + error.message(), given);
    r.folder_ = path.string();
    r.path_ = (path / (path.filename().string() + "_0.mcap")).string();
  }
  XAUTO_ASSIGN(r.writer_, create_mcap(r.path_));
  return r;
}

Result<std::size_t> Recorder::add_topic(const Topic& topic) {
  if (!writer_) return fail(ErrorCode::kInvalid, "is closed", path_);
  if (topic.name.empty()) return fail(ErrorCode::kInvalid, "a topic needs a name", path_);
  for (const std::string* text :
       {&topic.name, &topic.type, &topic.serialization_format, &topic.schema_encoding})
    if (text->size() > kMaxTopicTextBytes)
      return fail(ErrorCode::kInvalid, "a topic's name, type or format is too long", path_);
  if (topic.schema.size() > kMaxSchemaBytes)
    return fail(ErrorCode::kInvalid, "a topic's schema is too long", path_);
  if (topics_.size() >= kMaxTopics)
    return fail(ErrorCode::kInvalid, "has 4096 topics already", path_);
  for (const Written& other : topics_)
    if (other.topic.name == topic.name)
      return fail(ErrorCode::kInvalid, "topic '" + topic.name + "' is there already", path_);
  XAUTO_TRY(writer_->add_topic(topic));
  topics_.push_back({topic, 0});
  return topics_.size() - 1;
}

Status Recorder::write(std::size_t topic, std::int64_t timestamp_ns,
                       std::span<const std::byte> data) {
  thread_.check();
  if (!writer_) return fail(ErrorCode::kInvalid, "is closed", path_);
  if (topic >= topics_.size())
    return fail(ErrorCode::kInvalid, "topic " + std::to_string(topic) + " was not added", path_);
  if (timestamp_ns < 0 || timestamp_ns > kMaxTimestampNs)
    return fail(ErrorCode::kInvalid,
                std::to_string(timestamp_ns) + " is not a time from 0 to " +
                    std::to_string(kMaxTimestampNs) + " ns",
                path_);
  if (data.size() > kMaxMessageBytes)
    return fail(ErrorCode::kInvalid,
                "a message of " + std::to_string(data.size()) + " bytes is longer than " +
                    std::to_string(kMaxMessageBytes),
                path_);
  XAUTO_TRY(writer_->write(topic, timestamp_ns, data));
  first_ns_ = num_messages_ == 0 ? timestamp_ns : std::min(first_ns_, timestamp_ns);
  last_ns_ = std::max(last_ns_, timestamp_ns);
  ++num_messages_;
  ++topics_[topic].messages;
  return {};
}

Status Recorder::flush() {
  thread_.check();
  return writer_ ? writer_->flush() : Status();
}

std::string Recorder::metadata(const std::string& indent) const {
  const std::string file = quoted(std::filesystem::path(path_).filename().string());
  const std::string duration = "nanoseconds: " + std::to_string(last_ns_ - first_ns_) + "\n";
  const std::string start = "nanoseconds_since_epoch: " + std::to_string(first_ns_) + "\n";
  const std::string count = "message_count: " + std::to_string(num_messages_) + "\n";
  std::string out;
  const auto line = [&](const std::string& text) { out += indent + text; };
  line("version: " + std::to_string(kMetadataVersion) + "\n");
  line("storage_identifier: mcap\n");
  line("duration:\n");
  line("  " + duration);
  line("starting_time:\n");
  line("  " + start);
  line(count);
  line(topics_.empty() ? "topics_with_message_count: []\n" : "topics_with_message_count:\n");
  for (const Written& written : topics_) {
    line("  - topic_metadata:\n");
    line("      name: " + quoted(written.topic.name) + "\n");
    line("      type: " + quoted(written.topic.type) + "\n");
    line("      serialization_format: " + quoted(written.topic.serialization_format) + "\n");
    line("      offered_qos_profiles: \"[]\"\n");
    line("    message_count: " + std::to_string(written.messages) + "\n");
  }
  line("compression_format: \"\"\n");
  line("compression_mode: \"\"\n");
  line("relative_file_paths:\n");
  line("  - " + file + "\n");
  line("files:\n");
  line("  - path: " + file + "\n");
  line("    starting_time:\n");
  line("      " + start);
  line("    duration:\n");
  line("      " + duration);
  line("    " + count);
  return out;
}

Status Recorder::close() {
  thread_.check();
  if (!writer_) return {};
  const Status done = writer_->close(metadata(""));
  writer_.reset();
  if (!done) {
    Error error = done.error();
    error.what = "the last messages could not be written: " + error.what;
    return tl::unexpected<Error>(std::move(error));
  }
  if (folder_.empty()) return {};
  const std::string yaml = folder_ + "/metadata.yaml";
  std::ofstream out(yaml);
  out << "rosbag2_bagfile_information:\n" << metadata("  ");
  out.close();
  if (!out) return fail(ErrorCode::kIo, "cannot be written", yaml);
  return {};
}

}  // namespace xauto::record

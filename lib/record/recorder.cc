// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include <sqlite3.h>

#include "record/recording.h"

namespace xauto::record {
namespace {

// A batch is what a killed recorder loses.
constexpr std::size_t kBatchMessages = 256;
constexpr std::size_t kBatchBytes = 16u << 20;
constexpr int kMetadataVersion = 5;

// The tables of rosbag2's schema version 3; readers of versions 1 to 4 take it.
constexpr const char* kSchema =
    "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
    "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,"
    " metadata TEXT NOT NULL);"
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
    " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
    " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
    "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    "INSERT INTO schema(schema_version, ros_distro) VALUES (3, '');";

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

void bind_text(sqlite3_stmt* statement, int index, const std::string& text) {
  sqlite3_bind_text64(statement, index, text.data(), text.size(), SQLITE_TRANSIENT, SQLITE_UTF8);
}

Result<Statement> prepare(sqlite3* database, const std::string& path, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database), path);
  return Statement(statement);
}

}  // namespace

Result<Recorder> Recorder::create(const std::string& given) {
  namespace fs = std::filesystem;
  fs::path path = given;
  if (!path.has_filename()) path = path.parent_path();  // "drive/"
  std::error_code error;
  if (fs::exists(path, error))
    return fail(ErrorCode::kInvalid, "exists already", given, "record under a new name");
  Recorder r;
  r.path_ = path.string();
  if (path.extension() != ".db3") {
    if (!fs::create_directory(path, error))
      return fail(ErrorCode::kNotFound, "cannot be created: " + error.message(), given);
    r.folder_ = path.string();
    r.path_ = (path / (path.filename().string() + "_0.db3")).string();
  }
  sqlite3* database = nullptr;
  const int opened = sqlite3_open_v2(r.path_.c_str(), &database,
                                     SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr);
  r.database_.reset(database);
  if (opened != SQLITE_OK) {
    Error failure{ErrorCode::kNotFound,
                  std::string("cannot be created: ") + sqlite3_errmsg(database),
                  r.path_,
                  {}};
    r.database_.reset();
    return tl::unexpected<Error>(std::move(failure));
  }
  // The journal is a file, so that a recorder that is killed leaves a recording that can be opened;
  // nobody waits for the disk, so that recording does not disturb what it records.
  for (const char* sql : {"PRAGMA journal_mode=DELETE", "PRAGMA synchronous=OFF", kSchema, "BEGIN"})
    XAUTO_TRY(r.execute(sql));
  XAUTO_ASSIGN(r.insert_,
               prepare(database, r.path_,
                       "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"));
  return r;
}

Recorder::~Recorder() {
  if (database_) (void)close();
}

Status Recorder::execute(const char* sql) const {
  if (sqlite3_exec(database_.get(), sql, nullptr, nullptr, nullptr) != SQLITE_OK)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  return {};
}

Result<std::size_t> Recorder::add_topic(const Topic& topic) {
  if (!database_) return fail(ErrorCode::kInvalid, "is closed", path_);
  if (topic.name.empty()) return fail(ErrorCode::kInvalid, "a topic needs a name", path_);
  for (const std::string* text : {&topic.name, &topic.type, &topic.serialization_format})
    if (text->size() > kMaxTopicTextBytes)
      return fail(ErrorCode::kInvalid, "a topic's name, type or format is too long", path_);
  if (topics_.size() >= kMaxTopics)
    return fail(ErrorCode::kInvalid, "has 4096 topics already", path_);
  for (const Written& other : topics_)
    if (other.topic.name == topic.name)
      return fail(ErrorCode::kInvalid, "topic '" + topic.name + "' is there already", path_);
  XAUTO_ASSIGN(
      const Statement insert,
      prepare(database_.get(), path_,
              "INSERT INTO topics(id, name, type, serialization_format, offered_qos_profiles)"
              " VALUES (?, ?, ?, ?, '[]')"));
  sqlite3_bind_int64(insert.get(), 1, static_cast<std::int64_t>(topics_.size() + 1));
  bind_text(insert.get(), 2, topic.name);
  bind_text(insert.get(), 3, topic.type);
  bind_text(insert.get(), 4, topic.serialization_format);
  if (sqlite3_step(insert.get()) != SQLITE_DONE)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  topics_.push_back({topic, 0});
  return topics_.size() - 1;
}

Status Recorder::write(std::size_t topic, std::int64_t timestamp_ns,
                       std::span<const std::byte> data) {
  thread_.check();
  if (!database_) return fail(ErrorCode::kInvalid, "is closed", path_);
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
  sqlite3_reset(insert_.get());
  sqlite3_bind_int64(insert_.get(), 1, static_cast<std::int64_t>(topic + 1));
  sqlite3_bind_int64(insert_.get(), 2, timestamp_ns);
  // An empty blob, not NULL, for an empty message.
  const void* bytes = data.empty() ? static_cast<const void*>("") : data.data();
  sqlite3_bind_blob64(insert_.get(), 3, bytes, data.size(), SQLITE_STATIC);
  const int done = sqlite3_step(insert_.get());
  sqlite3_clear_bindings(insert_.get());
  if (done != SQLITE_DONE) return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  first_ns_ = num_messages_ == 0 ? timestamp_ns : std::min(first_ns_, timestamp_ns);
  last_ns_ = std::max(last_ns_, timestamp_ns);
  ++num_messages_;
  ++topics_[topic].messages;
  batch_bytes_ += data.size();
  if (++batch_messages_ < kBatchMessages && batch_bytes_ < kBatchBytes) return {};
  batch_messages_ = batch_bytes_ = 0;
  sqlite3_reset(insert_.get());
  return execute("COMMIT; BEGIN");
}

std::string Recorder::metadata(const std::string& indent) const {
  const std::string file = quoted(std::filesystem::path(path_).filename().string());
  const std::string duration = "nanoseconds: " + std::to_string(last_ns_ - first_ns_) + "\n";
  const std::string start = "nanoseconds_since_epoch: " + std::to_string(first_ns_) + "\n";
  const std::string count = "message_count: " + std::to_string(num_messages_) + "\n";
  std::string out;
  const auto line = [&](const std::string& text) { out += indent + text; };
  line("version: " + std::to_string(kMetadataVersion) + "\n");
  line("storage_identifier: sqlite3\n");
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

Status Recorder::insert_metadata(const std::string& yaml) const {
  XAUTO_ASSIGN(const Statement insert,
               prepare(database_.get(), path_,
                       "INSERT INTO metadata(metadata_version, metadata) VALUES (?, ?)"));
  sqlite3_bind_int(insert.get(), 1, kMetadataVersion);
  bind_text(insert.get(), 2, yaml);
  if (sqlite3_step(insert.get()) != SQLITE_DONE)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  return {};
}

Status Recorder::close() {
  thread_.check();
  if (!database_) return {};
  insert_.reset();
  Status done = insert_metadata(metadata(""));
  if (Status committed = execute("COMMIT"); done) done = std::move(committed);
  database_.reset();
  if (!done) {
    Error error = std::move(done).error();
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

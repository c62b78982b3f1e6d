// SPDX-License-Identifier: Apache-2.0
// rosbag2's sqlite3 storage (schema versions 1 to 4), read.
#include <algorithm>
#include <filesystem>
#include <set>

#include "record/salvage.h"
#include "record/sqlite_file.h"
#include "record/storage.h"

namespace xauto::record {
namespace {

constexpr int kMaxSchemaVersion = 4;
using Statement = SqliteStatement;

class SqliteReader final : public Reader {
 public:
  static Result<std::unique_ptr<Reader>> open(const std::string& path);

  [[nodiscard]] const std::vector<Topic>& topics() const override { return topics_; }
  [[nodiscard]] std::uint64_t num_messages() const override { return num_messages_; }
  [[nodiscard]] Result<std::int64_t> start_ns() override;
  [[nodiscard]] Result<std::optional<Message>> next() override;
  [[nodiscard]] static Status salvage(const std::string& path, const Take& take, Salvaged& out);

 private:
  [[nodiscard]] Status open_database();
  [[nodiscard]] Result<Statement> prepare(const char* sql) const { return file_->prepare(sql); }
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const {
    return file_->broken(what);
  }
  [[nodiscard]] tl::unexpected<Error> damaged() const { return file_->damaged(); }
  [[nodiscard]] Result<Message> head_of(sqlite3_stmt* row) const;
  [[nodiscard]] Result<std::vector<std::byte>> data_of(sqlite3_stmt* row, int column,
                                                       std::int64_t id) const;
  [[nodiscard]] Status check_layout() const;
  [[nodiscard]] Status read_topics();
  [[nodiscard]] Status count_messages(std::uint64_t file_bytes);

  OneThread thread_;
  std::string path_;
  std::unique_ptr<SqliteFile> file_;
  Statement order_;  ///< rows by time
  Statement data_;   ///< the blob of one row, so that sorting never moves blobs
  std::vector<Topic> topics_;
  std::vector<std::int64_t> topic_ids_;
  std::uint64_t num_messages_ = 0, num_read_ = 0;
  std::int64_t last_ns_ = 0;
  bool finished_ = false;
};

Status SqliteReader::open_database() {
  XAUTO_ASSIGN(file_, SqliteFile::open(path_, kMaxMessageBytes));
  XAUTO_TRY(check_layout());
  return read_topics();
}

Result<std::unique_ptr<Reader>> SqliteReader::open(const std::string& path) {
  auto r = std::make_unique<SqliteReader>();
  r->path_ = path;
  XAUTO_TRY(r->open_database());
  std::error_code error;
  XAUTO_TRY(r->count_messages(std::filesystem::file_size(path, error)));
  XAUTO_ASSIGN(
      r->order_,
      r->prepare("SELECT rowid, topic_id, timestamp FROM messages ORDER BY timestamp, rowid"));
  XAUTO_ASSIGN(r->data_, r->prepare("SELECT data FROM messages WHERE rowid = ?"));
  return r;
}

Status SqliteReader::check_layout() const {
  struct Table {
    const char* name;
    std::vector<const char*> columns;
  };
  const Table tables[] = {{"topics", {"id", "name", "type", "serialization_format"}},
                          {"messages", {"id", "topic_id", "timestamp", "data"}}};
  for (const Table& table : tables) {
    XAUTO_ASSIGN(const std::set<std::string> there, file_->columns_of(table.name));
    if (there.empty())
      return broken(std::string("is no rosbag2 recording: table '") + table.name + "' is missing");
    for (const char* column : table.columns)
      if (!there.contains(column))
        return broken(std::string("is no rosbag2 recording: table '") + table.name +
                      "' has no column '" + column + "'");
  }
  XAUTO_ASSIGN(const std::set<std::string> schema, file_->columns_of("schema"));
  if (schema.empty()) return {};  // versions 1 and 2 had no such table
  XAUTO_ASSIGN(const Statement version, prepare("SELECT schema_version FROM schema NOT INDEXED"));
  if (sqlite3_step(version.get()) != SQLITE_ROW ||
      sqlite3_column_type(version.get(), 0) != SQLITE_INTEGER)
    return broken("table 'schema' states no version");
  const std::int64_t number = sqlite3_column_int64(version.get(), 0);
  if (number < 1 || number > kMaxSchemaVersion)
    return broken("has schema version " + std::to_string(number) + ", this program reads 1 to " +
                  std::to_string(kMaxSchemaVersion));
  return {};
}

Status SqliteReader::read_topics() {
  XAUTO_ASSIGN(const Statement rows,
               prepare("SELECT id, name, type, serialization_format FROM topics NOT INDEXED"));
  static constexpr const char* kColumns[] = {"id", "name", "type", "serialization_format"};
  std::set<std::string> names;
  std::vector<std::pair<std::int64_t, Topic>> topics;
  int step;
  while ((step = sqlite3_step(rows.get())) == SQLITE_ROW) {
    if (topics.size() >= kMaxTopics)
      return broken("has more than " + std::to_string(kMaxTopics) + " topics");
    if (sqlite3_column_type(rows.get(), 0) != SQLITE_INTEGER)
      return broken("topics.id is not an integer");
    for (int column = 1; column < 4; ++column) {
      const std::string what = std::string("topics.") + kColumns[column];
      if (sqlite3_column_type(rows.get(), column) != SQLITE_TEXT)
        return broken(what + " is not a text");
      if (static_cast<std::size_t>(sqlite3_column_bytes(rows.get(), column)) > kMaxTopicTextBytes)
        return broken(what + " is longer than " + std::to_string(kMaxTopicTextBytes) + " bytes");
    }
    Topic topic{text_of(rows.get(), 1), text_of(rows.get(), 2), text_of(rows.get(), 3)};
    if (topic.name.empty()) return broken("a topic has no name");
    if (!names.insert(topic.name).second)
      return broken("topic " + shown(topic.name) + " is there twice");
    topics.emplace_back(sqlite3_column_int64(rows.get(), 0), std::move(topic));
  }
  if (step != SQLITE_DONE) return damaged();
  std::sort(topics.begin(), topics.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  for (auto& [id, topic] : topics) {
    if (!topic_ids_.empty() && topic_ids_.back() == id)
      return broken("topic id " + std::to_string(id) + " is there twice");
    topic_ids_.push_back(id);
    topics_.push_back(std::move(topic));
  }
  return {};
}

/// By reading every row's key once: count(*) cannot be interrupted.
Status SqliteReader::count_messages(std::uint64_t file_bytes) {
  XAUTO_ASSIGN(const Statement rows, prepare("SELECT rowid FROM messages NOT INDEXED"));
  int step;
  while ((step = sqlite3_step(rows.get())) == SQLITE_ROW)
    if (++num_messages_ > file_bytes) return broken("is damaged: its pages lead in circles");
  if (step != SQLITE_DONE) return damaged();
  return {};
}

Result<std::int64_t> SqliteReader::start_ns() {
  thread_.check();
  XAUTO_ASSIGN(const Statement first, prepare("SELECT MIN(timestamp) FROM messages"));
  if (sqlite3_step(first.get()) != SQLITE_ROW) return damaged();
  return sqlite3_column_int64(first.get(), 0);
}

std::string message_name(std::int64_t id) {
  return "message " + std::to_string(id) + ": ";
}

/// Topic and time of a row whose first columns are rowid, topic_id and timestamp.
Result<Message> SqliteReader::head_of(sqlite3_stmt* row) const {
  const std::string which = message_name(sqlite3_column_int64(row, 0));
  if (sqlite3_column_type(row, 1) != SQLITE_INTEGER)
    return broken(which + "topic_id is not an integer");
  if (sqlite3_column_type(row, 2) != SQLITE_INTEGER)
    return broken(which + "timestamp is not an integer");
  Message message;
  const std::int64_t topic = sqlite3_column_int64(row, 1);
  const auto found = std::lower_bound(topic_ids_.begin(), topic_ids_.end(), topic);
  if (found == topic_ids_.end() || *found != topic)
    return broken(which + "topic_id " + std::to_string(topic) + " is not in table 'topics'");
  message.topic = static_cast<std::size_t>(found - topic_ids_.begin());
  message.timestamp_ns = sqlite3_column_int64(row, 2);
  if (message.timestamp_ns < 0 || message.timestamp_ns > kMaxTimestampNs)
    return broken(which + "timestamp " + std::to_string(message.timestamp_ns) +
                  " is not from 0 to " + std::to_string(kMaxTimestampNs) + " ns");
  return message;
}

Result<std::vector<std::byte>> SqliteReader::data_of(sqlite3_stmt* row, int column,
                                                     std::int64_t id) const {
  if (sqlite3_column_type(row, column) != SQLITE_BLOB)
    return broken(message_name(id) + "data is not a blob");
  const auto* data = static_cast<const std::byte*>(sqlite3_column_blob(row, column));
  const auto bytes = static_cast<std::size_t>(sqlite3_column_bytes(row, column));
  if (data == nullptr && bytes > 0) return damaged();
  return std::vector<std::byte>(data, data + bytes);
}

/// By the table alone, since an index may be what is broken; from its end where its pages are, in the middle.
Status SqliteReader::salvage(const std::string& path, const Take& take, Salvaged& out) {
  SqliteReader reader;
  reader.path_ = path;
  if (const Status opened = reader.open_database(); !opened) {
    if (opened.error().code != ErrorCode::kInvalid) return opened;
    out.leave_out(path, opened.error().what);
    return {};
  }
  reader.file_->again(1);  // there are two ways through
  bool any = false;
  std::int64_t last = 0;
  for (const bool backwards : {false, true}) {
    auto rows = reader.prepare(
        backwards
            ? "SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY rowid "
              "DESC"
            : "SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY rowid");
    int step = SQLITE_ERROR;
    while (rows && (step = sqlite3_step(rows->get())) == SQLITE_ROW) {
      const std::int64_t id = sqlite3_column_int64(rows->get(), 0);
      if (any && id <= last) break;  // known already, or pages that lead in circles
      if (!backwards) {
        any = true;
        last = id;
      }
      const Result<Message> message = reader.head_of(rows->get());
      const auto data =
          message ? reader.data_of(rows->get(), 3, id) : tl::unexpected<Error>(message.error());
      if (!data) {
        out.leave_out(path, data.error().what);
        continue;
      }
      XAUTO_TRY(take(reader.topics_[message->topic], message->timestamp_ns, *data));
      ++out.messages;
    }
    if (step == SQLITE_DONE || step == SQLITE_ROW) return {};
    out.leave_out(path, (any ? "after message " + std::to_string(last) + ": " : std::string()) +
                            reader.damaged().value().what);
  }
  return {};
}

Result<std::optional<Message>> SqliteReader::next() {
  thread_.check();
  if (finished_) return std::optional<Message>();
  const int step = sqlite3_step(order_.get());
  if (step == SQLITE_DONE && num_read_ == num_messages_) {
    finished_ = true;
    return std::optional<Message>();
  }
  if (step == SQLITE_DONE || (step == SQLITE_ROW && num_read_ == num_messages_))
    return broken("is damaged: its index does not list its messages");
  if (step != SQLITE_ROW) return damaged();
  ++num_read_;
  XAUTO_ASSIGN(Message message, head_of(order_.get()));
  const std::int64_t id = sqlite3_column_int64(order_.get(), 0);
  const std::string which = message_name(id);
  if (message.timestamp_ns < last_ns_) return broken("is damaged: its index is not in order");
  last_ns_ = message.timestamp_ns;

  sqlite3_stmt* blob = data_.get();
  sqlite3_reset(blob);
  sqlite3_bind_int64(blob, 1, id);
  const int got = sqlite3_step(blob);
  if (got == SQLITE_DONE)
    return broken("is damaged: its index lists " + which + "which is not there");
  if (got == SQLITE_TOOBIG)
    return broken(which + "data is longer than " + std::to_string(kMaxMessageBytes) + " bytes");
  if (got != SQLITE_ROW) return damaged();
  XAUTO_ASSIGN(message.data, data_of(blob, 0, id));
  return std::optional<Message>(std::move(message));
}

}  // namespace

Status salvage_sqlite(const std::string& path, const Take& take, Salvaged& out) {
  return SqliteReader::salvage(path, take, out);
}

Result<std::unique_ptr<Reader>> open_sqlite(const std::string& path) {
  return SqliteReader::open(path);
}

}  // namespace xauto::record

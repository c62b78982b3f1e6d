// SPDX-License-Identifier: Apache-2.0
// rosbag2's sqlite3 storage (schema versions 1 to 4), read. A file is an attack until it is proven to
// be tables with rows: it must not run code, write, or keep us for ever.
#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>

#include <sqlite3.h>

#include "record/sqlite.h"
#include "record/storage.h"

namespace xauto::record {
namespace {

constexpr int kMaxSchemaVersion = 4;
// Of SQLite's machine, per call of the progress handler; per byte of the file; and to start with.
// Reading a recording once takes some 30 steps per message, and a message is at least 10 bytes
// long.
constexpr int kStepsPerCall = 1000;
constexpr std::int64_t kStepsPerByte = 20, kStepsToStart = 2'000'000;

int spend(void* budget) {
  auto& left = *static_cast<std::int64_t*>(budget);
  left -= kStepsPerCall;
  return left < 0 ? 1 : 0;
}

std::string text_of(sqlite3_stmt* row, int column) {
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(row, column));
  return text == nullptr
             ? ""
             : std::string(text, static_cast<std::size_t>(sqlite3_column_bytes(row, column)));
}

class SqliteReader final : public Reader {
 public:
  static Result<std::unique_ptr<Reader>> open(const std::string& path);

  [[nodiscard]] const std::vector<Topic>& topics() const override { return topics_; }
  [[nodiscard]] std::uint64_t num_messages() const override { return num_messages_; }
  [[nodiscard]] Result<std::int64_t> start_ns() override;
  [[nodiscard]] Result<std::optional<Message>> next() override;

 private:
  [[nodiscard]] Result<Statement> prepare(const char* sql) const;
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const;
  [[nodiscard]] tl::unexpected<Error> damaged() const;  ///< with SQLite's last error
  [[nodiscard]] Status check_layout() const;
  [[nodiscard]] Status read_topics();
  [[nodiscard]] Status count_messages(std::uint64_t file_bytes);

  OneThread thread_;
  std::string path_;
  /// Steps of SQLite's machine left: pages that refer to each other in circles must not hang us.
  std::int64_t budget_ = 0;
  Database database_;
  Statement order_;  ///< rows by time
  Statement data_;   ///< the blob of one row, so that sorting never moves blobs
  std::vector<Topic> topics_;
  std::vector<std::int64_t> topic_ids_;
  std::uint64_t num_messages_ = 0, num_read_ = 0;
  std::int64_t last_ns_ = 0;
  bool finished_ = false;
};

tl::unexpected<Error> SqliteReader::broken(const std::string& what) const {
  return fail(ErrorCode::kInvalid, what, path_);
}

tl::unexpected<Error> SqliteReader::damaged() const {
  switch (sqlite3_errcode(database_.get())) {
    case SQLITE_INTERRUPT:
      return broken("is damaged: its pages lead in circles");
    case SQLITE_TOOBIG:
      return broken("holds a value of more than " + std::to_string(kMaxMessageBytes) + " bytes");
    case SQLITE_READONLY:
    case SQLITE_CANTOPEN:
      return fail(ErrorCode::kInvalid, "was not closed by its recorder", path_,
                  "`sqlite3 " + path_ + " .tables` repairs it, with the right to write there");
    default:
      return broken(std::string("is damaged: ") + sqlite3_errmsg(database_.get()));
  }
}

Result<Statement> SqliteReader::prepare(const char* sql) const {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database_.get(), sql, -1, &statement, nullptr) != SQLITE_OK)
    return damaged();
  return Statement(statement);
}

Result<std::unique_ptr<Reader>> SqliteReader::open(const std::string& path) {
  auto r = std::make_unique<SqliteReader>();
  r->path_ = path;
  std::error_code error;
  const std::uint64_t bytes = std::filesystem::file_size(path, error);
  char magic[16] = {};
  if (std::ifstream in(path, std::ios::binary); !in) {
    return r->broken("cannot be opened");
  } else if (!in.read(magic, sizeof magic) ||
             std::memcmp(magic, "SQLite format 3", sizeof magic) != 0) {
    return r->broken("is not an SQLite file");
  }
  sqlite3* database = nullptr;
  const int opened = sqlite3_open_v2(r->path_.c_str(), &database, SQLITE_OPEN_READONLY, nullptr);
  r->database_.reset(database);
  if (opened != SQLITE_OK) return r->damaged();
  sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(database, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
  sqlite3_limit(database, SQLITE_LIMIT_LENGTH, static_cast<int>(kMaxMessageBytes));
  sqlite3_exec(database, "PRAGMA cell_size_check=ON; PRAGMA mmap_size=0", nullptr, nullptr,
               nullptr);
  r->budget_ = kStepsToStart + static_cast<std::int64_t>(bytes) * kStepsPerByte;
  sqlite3_progress_handler(database, kStepsPerCall, spend, &r->budget_);

  XAUTO_TRY(r->check_layout());
  XAUTO_TRY(r->read_topics());
  XAUTO_TRY(r->count_messages(bytes));
  XAUTO_ASSIGN(
      r->order_,
      r->prepare("SELECT rowid, topic_id, timestamp FROM messages ORDER BY timestamp, rowid"));
  XAUTO_ASSIGN(r->data_, r->prepare("SELECT data FROM messages WHERE rowid = ?"));
  return r;
}

/// Real tables with real columns: views and generated columns would compute what the file's author
/// wants.
Status SqliteReader::check_layout() const {
  struct Table {
    const char *name, *info;
    std::vector<const char*> columns;
  };
  const Table tables[] = {
      {"topics", "PRAGMA table_info(topics)", {"id", "name", "type", "serialization_format"}},
      {"messages", "PRAGMA table_info(messages)", {"id", "topic_id", "timestamp", "data"}}};
  for (const Table& table : tables) {
    XAUTO_ASSIGN(const Statement find,
                 prepare("SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?"));
    sqlite3_bind_text(find.get(), 1, table.name, -1, SQLITE_STATIC);
    const int step = sqlite3_step(find.get());
    if (step != SQLITE_ROW && step != SQLITE_DONE) return damaged();
    if (step == SQLITE_DONE || sqlite3_column_int64(find.get(), 0) <= 0)
      return broken(std::string("is no rosbag2 recording: table '") + table.name + "' is missing");
    XAUTO_ASSIGN(const Statement info, prepare(table.info));
    std::set<std::string> there;
    while (sqlite3_step(info.get()) == SQLITE_ROW) there.insert(text_of(info.get(), 1));
    for (const char* column : table.columns)
      if (!there.contains(column))
        return broken(std::string("is no rosbag2 recording: table '") + table.name +
                      "' has no column '" + column + "'");
  }
  XAUTO_ASSIGN(const Statement find,
               prepare("SELECT rootpage FROM sqlite_master WHERE type = 'table'"
                       " AND name = 'schema'"));
  const int step = sqlite3_step(find.get());
  if (step == SQLITE_DONE) return {};  // versions 1 and 2 had no such table
  if (step != SQLITE_ROW || sqlite3_column_int64(find.get(), 0) <= 0) return damaged();
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

Result<std::optional<Message>> SqliteReader::next() {
  thread_.check();
  if (finished_) return std::optional<Message>();
  sqlite3_stmt* row = order_.get();
  const int step = sqlite3_step(row);
  if (step == SQLITE_DONE && num_read_ == num_messages_) {
    finished_ = true;
    return std::optional<Message>();
  }
  if (step == SQLITE_DONE || (step == SQLITE_ROW && num_read_ == num_messages_))
    return broken("is damaged: its index does not list its messages");
  if (step != SQLITE_ROW) return damaged();
  ++num_read_;
  const std::int64_t id = sqlite3_column_int64(row, 0);
  const std::string which = "message " + std::to_string(id) + ": ";
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
  if (sqlite3_column_type(blob, 0) != SQLITE_BLOB) return broken(which + "data is not a blob");
  const auto* data = static_cast<const std::byte*>(sqlite3_column_blob(blob, 0));
  const auto bytes = static_cast<std::size_t>(sqlite3_column_bytes(blob, 0));
  if (data == nullptr && bytes > 0) return damaged();
  message.data.assign(data, data + bytes);
  return std::optional<Message>(std::move(message));
}

}  // namespace

void SqliteCloser::operator()(sqlite3* database) const {
  sqlite3_close_v2(database);
}
void SqliteCloser::operator()(sqlite3_stmt* statement) const {
  sqlite3_finalize(statement);
}

Result<std::unique_ptr<Reader>> open_sqlite(const std::string& path) {
  return SqliteReader::open(path);
}

}  // namespace xauto::record

// SPDX-License-Identifier: Apache-2.0
// rosbag2's sqlite3 storage (schema versions 1 to 4), read. A file is an attack until it is proven to
// be tables with rows: it must not run code, write, or keep us for ever.
#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>

#include <fmt/format.h>
#include <sqlite3.h>

#include "record/salvage.h"
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

struct SqliteCloser {
  void operator()(sqlite3* database) const { sqlite3_close_v2(database); }
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Database = std::unique_ptr<sqlite3, SqliteCloser>;
using Statement = std::unique_ptr<sqlite3_stmt, SqliteCloser>;

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
  [[nodiscard]] Result<Statement> prepare(const char* sql) const;
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const;
  [[nodiscard]] tl::unexpected<Error> damaged() const;  ///< with SQLite's last error
  [[nodiscard]] Result<Message> head_of(sqlite3_stmt* row) const;
  [[nodiscard]] Result<std::vector<std::byte>> data_of(sqlite3_stmt* row, int column,
                                                       std::int64_t id) const;
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
      return fail(
          ErrorCode::kInvalid,
          "was not closed by its recorder: a journal beside it (-wal, -journal) is part of it, "
          "and its folder cannot be written",
          path_, "copy both to where you may write, and read the copy");
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

/// In WAL mode, and its log has been merged: the file is all there is. SQLite would make a -shm beside
/// it, which a medium that cannot be written refuses.
bool is_merged_wal(const std::string& path) {
  constexpr std::streamoff kReadVersion = 19;  // of the header: 2 is WAL
  std::ifstream in(path, std::ios::binary);
  std::error_code error;
  const auto log = std::filesystem::file_size(path + "-wal", error);
  return in.seekg(kReadVersion) && in.get() == 2 && (error || log == 0);
}

/// As SQLite's URIs have it.
std::string immutable_uri(const std::string& path) {
  std::string uri = "file:";
  for (const char c : std::filesystem::absolute(path).string())
    uri += c == '%' || c == '?' || c == '#' ? fmt::format("%{:02x}", static_cast<unsigned char>(c))
                                            : std::string(1, c);
  return uri + "?immutable=1";
}

Status SqliteReader::open_database() {
  std::error_code error;
  const std::uint64_t bytes = std::filesystem::file_size(path_, error);
  char magic[16] = {};
  if (std::ifstream in(path_, std::ios::binary); !in) {
    return broken("cannot be opened");
  } else if (!in.read(magic, sizeof magic) ||
             std::memcmp(magic, "SQLite format 3", sizeof magic) != 0) {
    return broken(bytes == 0 ? "is empty" : "is not an SQLite file");
  }
  budget_ = kStepsToStart + static_cast<std::int64_t>(bytes) * kStepsPerByte;
  const auto open = [this](const std::string& name, int flags) {
    sqlite3* database = nullptr;
    const int opened =
        sqlite3_open_v2(name.c_str(), &database, SQLITE_OPEN_READONLY | flags, nullptr);
    database_.reset(database);
    if (opened != SQLITE_OK) return false;
    sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_db_config(database, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
    sqlite3_limit(database, SQLITE_LIMIT_LENGTH, static_cast<int>(kMaxMessageBytes));
    sqlite3_progress_handler(database, kStepsPerCall, spend, &budget_);
    // The first that reads: only now is known whether it can be.
    return sqlite3_exec(database,
                        "PRAGMA cell_size_check=ON; PRAGMA mmap_size=0; PRAGMA schema_version",
                        nullptr, nullptr, nullptr) == SQLITE_OK;
  };
  if (!open(path_, 0)) {
    const int why = sqlite3_errcode(database_.get());
    const bool unwritable = why == SQLITE_CANTOPEN || why == SQLITE_READONLY;
    if (!unwritable || !is_merged_wal(path_) || !open(immutable_uri(path_), SQLITE_OPEN_URI))
      return damaged();
  }
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
  reader.budget_ *= 2;  // for two ways through
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

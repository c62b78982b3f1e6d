// SPDX-License-Identifier: Apache-2.0
#include "record/recording.h"

#include <sqlite3.h>
#include <sys/stat.h>

#include <filesystem>

namespace xauto::record {
namespace {

constexpr std::size_t kBatch = 256;
constexpr const char* kSchema =
    "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
    "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);"
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
    " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
    " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
    "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    "INSERT INTO schema(schema_version, ros_distro) VALUES (3, 'xauto');";

tl::unexpected<Error> broken(const std::string& path, const std::string& what) {
  return fail(ErrorCode::kInvalid, what, path);
}

Result<Statement> prepare(sqlite3* database, const std::string& path, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK)
    return broken(path, std::string("is no rosbag2 recording: ") + sqlite3_errmsg(database));
  return Statement(statement);
}

/// The one .db3 file of a rosbag2 folder.
Result<std::string> resolve(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_directory(path, error)) return path;
  std::string found;
  for (const auto& entry : std::filesystem::directory_iterator(path, error)) {
    if (entry.path().extension() != ".db3") continue;
    if (!found.empty()) return broken(path, "holds several .db3 files; name the one to read");
    found = entry.path().string();
  }
  if (error || found.empty()) return broken(path, "holds no .db3 file");
  return found;
}

Result<std::string> text_column(sqlite3_stmt* row, int column, const std::string& path,
                                const char* name) {
  if (sqlite3_column_type(row, column) != SQLITE_TEXT)
    return broken(path, std::string("topics.") + name + " is not a text");
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(row, column));
  return std::string(text, static_cast<std::size_t>(sqlite3_column_bytes(row, column)));
}

}  // namespace

void SqliteCloser::operator()(sqlite3* database) const { sqlite3_close_v2(database); }
void SqliteCloser::operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }

Result<Recording> Recording::open(const std::string& given) {
  Recording r;
  XAUTO_ASSIGN(r.path_, resolve(given));
  struct stat status {};
  if (stat(r.path_.c_str(), &status) != 0)
    return fail(ErrorCode::kNotFound, "there is no such recording", r.path_);
  if (!S_ISREG(status.st_mode)) return broken(r.path_, "is not a regular file");
  sqlite3* database = nullptr;
  const int opened = sqlite3_open_v2(r.path_.c_str(), &database, SQLITE_OPEN_READONLY, nullptr);
  r.database_.reset(database);
  if (opened != SQLITE_OK) return broken(r.path_, "cannot be opened as SQLite");
  // A hostile file must not run code or write: no views with functions, no schema tricks.
  sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_limit(database, SQLITE_LIMIT_LENGTH, static_cast<int>(kMaxMessageBytes));

  XAUTO_ASSIGN(const Statement topics,
               prepare(database, r.path_, "SELECT id, name, type, serialization_format FROM topics ORDER BY id"));
  int step;
  while ((step = sqlite3_step(topics.get())) == SQLITE_ROW) {
    if (r.topics_.size() >= kMaxTopics) return broken(r.path_, "has more than 4096 topics");
    if (sqlite3_column_type(topics.get(), 0) != SQLITE_INTEGER)
      return broken(r.path_, "topics.id is not an integer");
    Topic topic;
    XAUTO_ASSIGN(topic.name, text_column(topics.get(), 1, r.path_, "name"));
    XAUTO_ASSIGN(topic.type, text_column(topics.get(), 2, r.path_, "type"));
    XAUTO_ASSIGN(topic.serialization_format,
                 text_column(topics.get(), 3, r.path_, "serialization_format"));
    if (topic.name.empty()) return broken(r.path_, "a topic has no name");
    for (const Topic& other : r.topics_)
      if (other.name == topic.name) return broken(r.path_, "topic '" + topic.name + "' is there twice");
    r.topics_.push_back(std::move(topic));
    r.topic_ids_.push_back(sqlite3_column_int64(topics.get(), 0));
  }
  if (step != SQLITE_DONE) return broken(r.path_, std::string("is damaged: ") + sqlite3_errmsg(database));
  if (r.topics_.empty()) return broken(r.path_, "has no topics");

  XAUTO_ASSIGN(const Statement count, prepare(database, r.path_, "SELECT count(*) FROM messages"));
  if (sqlite3_step(count.get()) != SQLITE_ROW)
    return broken(r.path_, std::string("is damaged: ") + sqlite3_errmsg(database));
  r.num_messages_ = static_cast<std::uint64_t>(sqlite3_column_int64(count.get(), 0));
  if (r.num_messages_ == 0) return broken(r.path_, "has no messages");
  XAUTO_ASSIGN(r.messages_,
               prepare(database, r.path_,
                       "SELECT topic_id, timestamp, data, id FROM messages ORDER BY timestamp, id"));
  return r;
}

Result<std::optional<Message>> Recording::next() {
  sqlite3_stmt* row = messages_.get();
  const int step = sqlite3_step(row);
  if (step == SQLITE_DONE) return std::optional<Message>();
  if (step != SQLITE_ROW)
    return broken(path_, std::string("is damaged: ") + sqlite3_errmsg(database_.get()));
  const std::string which = "message " + std::to_string(sqlite3_column_int64(row, 3));
  if (sqlite3_column_type(row, 0) != SQLITE_INTEGER || sqlite3_column_type(row, 1) != SQLITE_INTEGER)
    return broken(path_, which + ": topic_id or timestamp is not an integer");
  const int kind = sqlite3_column_type(row, 2);
  if (kind != SQLITE_BLOB) return broken(path_, which + ": data is not a blob");
  Message message;
  const std::int64_t id = sqlite3_column_int64(row, 0);
  while (message.topic < topic_ids_.size() && topic_ids_[message.topic] != id) ++message.topic;
  if (message.topic == topic_ids_.size())
    return broken(path_, which + ": topic_id " + std::to_string(id) + " is not in the topics table");
  message.timestamp_ns = sqlite3_column_int64(row, 1);
  if (message.timestamp_ns < 0)
    return broken(path_, which + ": timestamp " + std::to_string(message.timestamp_ns) + " is negative");
  const auto bytes = static_cast<std::size_t>(sqlite3_column_bytes(row, 2));
  const auto* data = static_cast<const std::byte*>(sqlite3_column_blob(row, 2));
  message.data.assign(data, data + bytes);
  return std::optional<Message>(std::move(message));
}

Result<Recorder> Recorder::create(const std::string& path) {
  std::error_code error;
  if (std::filesystem::exists(path, error))
    return fail(ErrorCode::kInvalid, "exists already", path, "record into a new file");
  Recorder r;
  r.path_ = path;
  sqlite3* database = nullptr;
  const int opened =
      sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr);
  r.database_.reset(database);
  if (opened != SQLITE_OK)
    return fail(ErrorCode::kNotFound, std::string("cannot be created: ") + sqlite3_errmsg(database), path);
  for (const char* sql : {"PRAGMA journal_mode=MEMORY", kSchema, "BEGIN"})
    if (sqlite3_exec(database, sql, nullptr, nullptr, nullptr) != SQLITE_OK)
      return fail(ErrorCode::kIo, sqlite3_errmsg(database), path);
  XAUTO_ASSIGN(r.insert_, prepare(database, path,
                                  "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"));
  return r;
}

Recorder::~Recorder() {
  if (database_) (void)close();
}

Result<std::size_t> Recorder::add_topic(const Topic& topic) {
  XAUTO_ASSIGN(const Statement insert,
               prepare(database_.get(), path_,
                       "INSERT INTO topics(id, name, type, serialization_format, offered_qos_profiles)"
                       " VALUES (?, ?, ?, ?, '')"));
  sqlite3_bind_int64(insert.get(), 1, static_cast<std::int64_t>(num_topics_ + 1));
  const std::string* texts[] = {&topic.name, &topic.type, &topic.serialization_format};
  for (int i = 0; i < 3; ++i)
    sqlite3_bind_text(insert.get(), i + 2, texts[i]->data(), static_cast<int>(texts[i]->size()),
                      SQLITE_TRANSIENT);
  if (sqlite3_step(insert.get()) != SQLITE_DONE)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  return num_topics_++;
}

Status Recorder::write(std::size_t topic, std::int64_t timestamp_ns, std::span<const std::byte> data) {
  if (topic >= num_topics_) return fail(ErrorCode::kInvalid, "unknown topic", path_);
  if (data.size() > kMaxMessageBytes)
    return fail(ErrorCode::kInvalid, "message of " + std::to_string(data.size()) + " bytes is too long", path_);
  sqlite3_reset(insert_.get());
  sqlite3_bind_int64(insert_.get(), 1, static_cast<std::int64_t>(topic + 1));
  sqlite3_bind_int64(insert_.get(), 2, timestamp_ns);
  sqlite3_bind_blob64(insert_.get(), 3, data.empty() ? static_cast<const void*>("") : data.data(), data.size(),
                      SQLITE_STATIC);
  if (sqlite3_step(insert_.get()) != SQLITE_DONE)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  if (++uncommitted_ < kBatch) return {};
  uncommitted_ = 0;
  if (sqlite3_exec(database_.get(), "COMMIT; BEGIN", nullptr, nullptr, nullptr) != SQLITE_OK)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  return {};
}

Status Recorder::close() {
  if (!database_) return {};
  insert_.reset();
  const bool good = sqlite3_exec(database_.get(), "COMMIT", nullptr, nullptr, nullptr) == SQLITE_OK;
  const std::string why = good ? "" : sqlite3_errmsg(database_.get());
  database_.reset();
  if (!good) return fail(ErrorCode::kIo, "the last messages could not be written: " + why, path_);
  return {};
}

}  // namespace xauto::record

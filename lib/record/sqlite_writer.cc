// SPDX-License-Identifier: Apache-2.0
// rosbag2's sqlite3 storage, written. Messages are committed in batches, when they are flushed, and on close.
#include <sqlite3.h>

#include "record/sqlite.h"
#include "record/storage.h"

namespace xauto::record {
namespace {

// A batch is what a killed recorder loses.
constexpr std::size_t kBatchMessages = 256;
constexpr std::size_t kBatchBytes = 16u << 20;

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

void bind_text(sqlite3_stmt* statement, int index, const std::string& text) {
  sqlite3_bind_text64(statement, index, text.data(), text.size(), SQLITE_TRANSIENT, SQLITE_UTF8);
}

Result<Statement> prepare(sqlite3* database, const std::string& path, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK)
    return fail(ErrorCode::kIo, sqlite3_errmsg(database), path);
  return Statement(statement);
}

class SqliteWriter final : public Writer {
 public:
  static Result<std::unique_ptr<Writer>> create(const std::string& path);

  [[nodiscard]] Status add_topic(const Topic& topic) override;
  [[nodiscard]] Status write(std::size_t topic, std::int64_t timestamp_ns,
                             std::span<const std::byte> data) override;
  [[nodiscard]] Status flush() override;
  [[nodiscard]] Status close(const std::string& metadata) override;

 private:
  [[nodiscard]] Status execute(const char* sql) const;
  [[nodiscard]] Status insert_metadata(const std::string& yaml) const;
  [[nodiscard]] tl::unexpected<Error> failed() const {
    return fail(ErrorCode::kIo, sqlite3_errmsg(database_.get()), path_);
  }

  std::string path_;
  Database database_;
  Statement insert_;
  std::int64_t num_topics_ = 0;
  std::size_t batch_messages_ = 0, batch_bytes_ = 0;
};

Result<std::unique_ptr<Writer>> SqliteWriter::create(const std::string& path) {
  auto w = std::make_unique<SqliteWriter>();
  w->path_ = path;
  sqlite3* database = nullptr;
  const int opened =
      sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr);
  w->database_.reset(database);
  if (opened != SQLITE_OK)
    return fail(ErrorCode::kNotFound, std::string("cannot be created: ") + sqlite3_errmsg(database),
                path);
  // The journal is a file, so that a recorder that is killed leaves a recording that can be opened;
  // nobody waits for the disk, so that recording does not disturb what it records.
  for (const char* sql : {"PRAGMA journal_mode=DELETE", "PRAGMA synchronous=OFF", kSchema, "BEGIN"})
    XAUTO_TRY(w->execute(sql));
  XAUTO_ASSIGN(
      w->insert_,
      prepare(database, path, "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"));
  return w;
}

Status SqliteWriter::execute(const char* sql) const {
  if (sqlite3_exec(database_.get(), sql, nullptr, nullptr, nullptr) != SQLITE_OK) return failed();
  return {};
}

Status SqliteWriter::add_topic(const Topic& topic) {
  XAUTO_ASSIGN(
      const Statement insert,
      prepare(database_.get(), path_,
              "INSERT INTO topics(id, name, type, serialization_format, offered_qos_profiles)"
              " VALUES (?, ?, ?, ?, '[]')"));
  sqlite3_bind_int64(insert.get(), 1, num_topics_ + 1);
  bind_text(insert.get(), 2, topic.name);
  bind_text(insert.get(), 3, topic.type);
  bind_text(insert.get(), 4, topic.serialization_format);
  if (sqlite3_step(insert.get()) != SQLITE_DONE) return failed();
  ++num_topics_;
  return {};
}

Status SqliteWriter::write(std::size_t topic, std::int64_t timestamp_ns,
                           std::span<const std::byte> data) {
  sqlite3_reset(insert_.get());
  sqlite3_bind_int64(insert_.get(), 1, static_cast<std::int64_t>(topic + 1));
  sqlite3_bind_int64(insert_.get(), 2, timestamp_ns);
  // An empty blob, not NULL, for an empty message.
  const void* bytes = data.empty() ? static_cast<const void*>("") : data.data();
  sqlite3_bind_blob64(insert_.get(), 3, bytes, data.size(), SQLITE_STATIC);
  const int done = sqlite3_step(insert_.get());
  sqlite3_clear_bindings(insert_.get());
  if (done != SQLITE_DONE) return failed();
  batch_bytes_ += data.size();
  if (++batch_messages_ < kBatchMessages && batch_bytes_ < kBatchBytes) return {};
  return flush();
}

Status SqliteWriter::flush() {
  batch_messages_ = batch_bytes_ = 0;
  sqlite3_reset(insert_.get());
  return execute("COMMIT; BEGIN");
}

Status SqliteWriter::insert_metadata(const std::string& yaml) const {
  XAUTO_ASSIGN(const Statement insert,
               prepare(database_.get(), path_,
                       "INSERT INTO metadata(metadata_version, metadata) VALUES (?, ?)"));
  sqlite3_bind_int(insert.get(), 1, kMetadataVersion);
  bind_text(insert.get(), 2, yaml);
  if (sqlite3_step(insert.get()) != SQLITE_DONE) return failed();
  return {};
}

Status SqliteWriter::close(const std::string& metadata) {
  insert_.reset();
  Status done = insert_metadata(metadata);
  if (Status committed = execute("COMMIT"); done) done = std::move(committed);
  database_.reset();
  return done;
}

}  // namespace

Result<std::unique_ptr<Writer>> create_sqlite(const std::string& path) {
  return SqliteWriter::create(path);
}

}  // namespace xauto::record

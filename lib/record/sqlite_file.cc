// SPDX-License-Identifier: Apache-2.0
#include "record/sqlite_file.h"

#include <cstring>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>

namespace xauto::record {
namespace {

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

}  // namespace

std::string text_of(sqlite3_stmt* row, int column) {
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(row, column));
  return text == nullptr
             ? ""
             : std::string(text, static_cast<std::size_t>(sqlite3_column_bytes(row, column)));
}

Result<std::unique_ptr<SqliteFile>> SqliteFile::open(const std::string& path,
                                                     std::uint64_t max_bytes) {
  std::unique_ptr<SqliteFile> file(new SqliteFile(path, max_bytes));
  XAUTO_TRY(file->open_database());
  return file;
}

tl::unexpected<Error> SqliteFile::broken(const std::string& what) const {
  return fail(ErrorCode::kInvalid, what, path_);
}

tl::unexpected<Error> SqliteFile::damaged() const {
  switch (sqlite3_errcode(database_.get())) {
    case SQLITE_INTERRUPT:
      return broken("is damaged: its pages lead in circles");
    case SQLITE_TOOBIG:
      return broken("holds a value of more than " + std::to_string(max_bytes_) + " bytes");
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

Result<SqliteStatement> SqliteFile::prepare(const std::string& sql) const {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database_.get(), sql.c_str(), -1, &statement, nullptr) != SQLITE_OK)
    return damaged();
  return SqliteStatement(statement);
}

Status SqliteFile::open_database() {
  std::error_code error;
  const std::uint64_t bytes = std::filesystem::file_size(path_, error);
  char magic[16] = {};
  if (std::ifstream in(path_, std::ios::binary); !in) {
    return broken("cannot be opened");
  } else if (!in.read(magic, sizeof magic) ||
             std::memcmp(magic, "SQLite format 3", sizeof magic) != 0) {
    return broken(bytes == 0 ? "is empty" : "is not an SQLite file");
  }
  budget_ = budget_once_ = kStepsToStart + static_cast<std::int64_t>(bytes) * kStepsPerByte;
  const auto open = [this](const std::string& name, int flags) {
    sqlite3* database = nullptr;
    const int opened =
        sqlite3_open_v2(name.c_str(), &database, SQLITE_OPEN_READONLY | flags, nullptr);
    database_.reset(database);
    if (opened != SQLITE_OK) return false;
    sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_db_config(database, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
    sqlite3_limit(database, SQLITE_LIMIT_LENGTH, static_cast<int>(max_bytes_));
    sqlite3_progress_handler(database, kStepsPerCall, spend, &budget_);
    // The first that reads: only now is known whether it can be.
    return sqlite3_exec(database,
                        "PRAGMA cell_size_check=ON; PRAGMA mmap_size=0; PRAGMA schema_version",
                        nullptr, nullptr, nullptr) == SQLITE_OK;
  };
  if (open(path_, 0)) return {};
  const int why = sqlite3_errcode(database_.get());
  const bool unwritable = why == SQLITE_CANTOPEN || why == SQLITE_READONLY;
  if (!unwritable || !is_merged_wal(path_) || !open(immutable_uri(path_), SQLITE_OPEN_URI))
    return damaged();
  return {};
}

Result<std::set<std::string>> SqliteFile::columns_of(const std::string& table) const {
  std::set<std::string> columns;
  XAUTO_ASSIGN(const SqliteStatement find,
               prepare("SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?"));
  sqlite3_bind_text(find.get(), 1, table.c_str(), -1, SQLITE_STATIC);
  const int step = sqlite3_step(find.get());
  if (step != SQLITE_ROW && step != SQLITE_DONE) return damaged();
  if (step == SQLITE_DONE || sqlite3_column_int64(find.get(), 0) <= 0) return columns;
  XAUTO_ASSIGN(const SqliteStatement info, prepare("SELECT name FROM pragma_table_info(?)"));
  sqlite3_bind_text(info.get(), 1, table.c_str(), -1, SQLITE_STATIC);
  while (sqlite3_step(info.get()) == SQLITE_ROW) columns.insert(text_of(info.get(), 0));
  return columns;
}

}  // namespace xauto::record

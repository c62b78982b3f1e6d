// SPDX-License-Identifier: Apache-2.0
// An SQLite file that somebody else has written. It is an attack until it is proven to be tables with rows: it must not
// run code, write, or keep us for ever.
#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>

#include <sqlite3.h>

#include <xauto/result.h>

namespace xauto::record {

struct SqliteCloser {
  void operator()(sqlite3* database) const { sqlite3_close_v2(database); }
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using SqliteStatement = std::unique_ptr<sqlite3_stmt, SqliteCloser>;

/// Open for reading. Threads: one. It stays where it is: SQLite counts in it.
class SqliteFile {
 public:
  /// `max_bytes`: of one value. Errors: no SQLite file, or one that cannot be read.
  [[nodiscard]] static Result<std::unique_ptr<SqliteFile>> open(const std::string& path,
                                                                std::uint64_t max_bytes);

  [[nodiscard]] Result<SqliteStatement> prepare(const std::string& sql) const;
  /// Of a real table, without those that it computes: views and generated columns would compute what the file's author
  /// wants. Empty: there is no such table. Errors: damaged().
  [[nodiscard]] Result<std::set<std::string>> columns_of(const std::string& table) const;
  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const;
  [[nodiscard]] tl::unexpected<Error> damaged() const;  ///< with SQLite's last error
  /// The file may be gone through so many more times.
  void again(std::int64_t times) { budget_ += times * budget_once_; }

  SqliteFile(const SqliteFile&) = delete;
  SqliteFile& operator=(const SqliteFile&) = delete;

 private:
  SqliteFile(std::string path, std::uint64_t max_bytes)
      : path_(std::move(path)), max_bytes_(max_bytes) {}
  [[nodiscard]] Status open_database();

  std::string path_;
  std::uint64_t max_bytes_;
  /// Steps of SQLite's machine left: pages that refer to each other in circles must not hang us.
  std::int64_t budget_ = 0, budget_once_ = 0;
  std::unique_ptr<sqlite3, SqliteCloser> database_;
};

[[nodiscard]] std::string text_of(sqlite3_stmt* row, int column);

}  // namespace xauto::record

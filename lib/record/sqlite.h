// SPDX-License-Identifier: Apache-2.0
// SQLite's objects, which close themselves.
#pragma once

#include <memory>

struct sqlite3;
struct sqlite3_stmt;

namespace xauto::record {

struct SqliteCloser {
  void operator()(sqlite3* database) const;
  void operator()(sqlite3_stmt* statement) const;
};
using Database = std::unique_ptr<sqlite3, SqliteCloser>;
using Statement = std::unique_ptr<sqlite3_stmt, SqliteCloser>;

}  // namespace xauto::record

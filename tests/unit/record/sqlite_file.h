// SPDX-License-Identifier: Apache-2.0
// Recordings in SQLite as rosbag2 makes them (schema version 3). XAuto only reads them.
#pragma once

#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sqlite3.h>

namespace xauto::test {

inline void run_sql(const std::string& path, const std::string& sql) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  char* message = nullptr;
  EXPECT_EQ(sqlite3_exec(database, ("PRAGMA synchronous=OFF;BEGIN;" + sql + ";COMMIT").c_str(),
                         nullptr, nullptr, &message),
            SQLITE_OK)
      << (message != nullptr ? message : "");
  sqlite3_free(message);
  sqlite3_close(database);
}

/// `topics` and `messages`: values of rows as SQL has them, without the id: "'/a', 't', 'cdr'", "1, 5, x'00'".
inline void write_sqlite(const std::string& path, const std::vector<std::string>& topics,
                         const std::vector<std::string>& messages) {
  std::string sql =
      "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
      "INSERT INTO schema VALUES (3, '');"
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
      " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
      "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
      " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
      "CREATE INDEX timestamp_idx ON messages (timestamp ASC);";
  for (const std::string& row : topics)
    sql += "INSERT INTO topics VALUES (NULL, " + row + ", '[]');";
  for (const std::string& row : messages) sql += "INSERT INTO messages VALUES (NULL, " + row + ");";
  run_sql(path, sql);
}

}  // namespace xauto::test

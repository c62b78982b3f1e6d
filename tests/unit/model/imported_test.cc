// SPDX-License-Identifier: Apache-2.0
#include "model/imported.h"

#include <gtest/gtest.h>

#include "model/json.h"

namespace xauto {
namespace {

constexpr const char* kImportedApp = R"({"schema": "xauto.app", "version": 3, "name": "a",
  "sources": [{"name": "s", "period_us": 1000}],
  "xnodes": [{"name": "x", "module": "m", "source": "s", "wcet_us": {"cpu": 10}}], "edges": [],
  "chains": [{"name": "c", "from": "s", "to": "x"}])";

Result<ImportedApp> read_app_and(const std::string& more) {
  return parse_imported(kImportedApp + more + "}", "app.json");
}

const std::string kSeen =
    R"("from": "t", "duration_us": 9, "cores": 2, "executors": [{"name": "e", "type": "events",
       "threads": 1, "groups": [{"type": "reentrant", "xnodes": ["x"]}]}],
       "xnodes": [{"name": "x", "times_us": [7, 8], "delay_us": 1, "lead_us": 2, "depth": 3}],
       "chains": [{"name": "c", "count": 4, "p50_us": 5, "p99_us": 6, "max_us": 7}])";

TEST(Imported, ComesBackAsItWasWritten) {
  const auto read = read_app_and(
      R"(, "groups": [["x"]], "todo": [{"at": "/deadline_us", "what": "w"}], "seen": {)" + kSeen +
      "}");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->seen.executors.at(0).kind, ExecutorKind::kEvents);
  EXPECT_EQ(read->seen.xnodes.at(0).times_us, (std::vector<std::int64_t>{7, 8}));
  EXPECT_EQ(read->todo.at(0).at, "/deadline_us");
  const auto again = parse_imported(to_json(*read), "again");
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, *read);
  // The app is the same with it and without.
  EXPECT_EQ(read->app.hash(), parse_app(std::string(kImportedApp) + "}", "app.json")->hash());
}

TEST(Imported, AnAppWithoutItIsOne) {
  const auto read = read_app_and("");
  ASSERT_TRUE(read);
  EXPECT_TRUE(read->seen.from.empty());
  EXPECT_TRUE(read->todo.empty());
}

TEST(Imported, WhatDoesNotFitTheAppIsRefusedWithItsPlace) {
  const auto with = [](std::string seen, const std::string& old, const std::string& fresh) {
    seen.replace(seen.find(old), old.size(), fresh);
    return read_app_and(R"(, "seen": {)" + seen + "}");
  };
  for (const auto& [old, fresh, where] :
       {std::tuple(R"("xnodes": ["x"])", R"("xnodes": ["y"])",
                   "/seen/executors/0/groups/0/xnodes/0"),
        std::tuple(R"("xnodes": ["x"])", R"("xnodes": ["x", "x"])",
                   "/seen/executors/0/groups/0/xnodes/1"),
        std::tuple(R"("events")", R"("spinning")", "/seen/executors/0/type"),
        std::tuple(R"("reentrant")", R"("exclusive")", "/seen/executors/0/groups/0/type"),
        std::tuple(R"("cores": 2)", R"("cores": 0)", "/seen/cores"),
        std::tuple("[7, 8]", "[0]", "/seen/xnodes/0/times_us/0"),
        std::tuple(R"("name": "c")", R"("name": "d")", "/seen/chains/0/name")}) {
    const auto read = with(kSeen, old, fresh);
    ASSERT_FALSE(read) << fresh;
    EXPECT_NE(read.error().where.find(where), std::string::npos) << read.error().to_string();
  }
}

TEST(Imported, TodoTextsAreTexts) {
  EXPECT_EQ(todo_text("plain"), "plain");
  EXPECT_EQ(todo_text("a\nb"), "a?b");
  std::string longer(kMaxNameBytes - 1, 'x');
  EXPECT_EQ(todo_text(longer + "é"), longer);
  EXPECT_TRUE(fault_of_name(todo_text("\xff\xfe" + std::string(500, '\xc3'))).empty());
}

}  // namespace
}  // namespace xauto

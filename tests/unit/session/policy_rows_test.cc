// SPDX-License-Identifier: Apache-2.0
// The policy's BPF map has a row per XNode: what the policy's file says of it.
#include "session/policy_rows.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

/// Three XNodes on a CPU, a GPU and a DLA.
Session three() {
  Session session;
  session.app.name = "app";
  session.app.xnodes = {
      {"a", "m", {{"cpu", 10}}}, {"b", "m", {{"gpu", 10}}}, {"c", "n", {{"dla", 5}}}};
  session.platform = {"p", {{"cpu0", "cpu"}, {"gpu0", "gpu"}, {"dla0", "dla"}}};
  session.policy.placements = {{0, 70}, {1, -3}, {2, 9}};
  return session;
}

TEST(PolicyRows, OfPrioritiesEveryXpuHasThem) {
  const auto rows = policy_rows(three(), 0);
  ASSERT_EQ(rows.size(), 3u);
  const char* xpus[] = {"cpu0", "gpu0", "dla0"};
  const std::int64_t priorities[] = {70, -3, 9};
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(rows[i].xpu, xpus[i]);
    EXPECT_EQ(rows[i].by, "priority");
    EXPECT_EQ(rows[i].value, priorities[i]);
    EXPECT_EQ(rows[i].keys, 0u);
    EXPECT_EQ(rows[i].xpu_index, i);
  }
  EXPECT_EQ(rows[1].xnode, "b");
}

TEST(PolicyRows, OfKeysTheFirstAndHowManyThereAre) {
  Session session = three();
  session.keys.emplace().placements = {{0, {1500}}, {1, {20, 40, 30}}, {2, {7}}};
  const auto rows = policy_rows(session, 0);
  EXPECT_EQ(rows[0].by, "key_us");
  EXPECT_EQ(rows[0].value, 1500);
  EXPECT_EQ(rows[0].keys, 1u);
  EXPECT_EQ(rows[1].value, 20);
  EXPECT_EQ(rows[1].keys, 3u);
}

TEST(PolicyRows, OfTablesThoseOfTheTableThatIsAskedFor) {
  Session session = three();
  session.keys.emplace();
  session.tables.emplace();
  session.tables->tables.resize(2);
  session.tables->tables[0].keys.placements = {{0, {1}}, {1, {2}}, {2, {3}}};
  session.tables->tables[1].keys.placements = {{0, {10}}, {0, {20}}, {-1, {30}}};
  session.tables->serves = {{.table = 1}, {.table = 0}};
  session.by_table = {session.policy, session.policy};
  session.by_table[1].placements[1].xpu = 0;
  EXPECT_EQ(first_table(session), 1u);
  const auto rows = policy_rows(session, 1);
  EXPECT_EQ(rows[1].xpu, "cpu0");
  EXPECT_EQ(rows[1].value, 20);
  EXPECT_EQ(rows[1].table, 1u);
  EXPECT_EQ(rows[2].by, "off");
  EXPECT_EQ(rows[2].xpu, "");
  EXPECT_EQ(policy_rows(session, 0)[2].by, "key_us");
}

TEST(PolicyRows, WhereNobodySchedulesNoRowSaysThatSomebodyDoes) {
  Session session = three();
  session.scheduling = Scheduling::kTimeshare;
  EXPECT_EQ(policy_rows(session, 0)[1].by, "nobody");
  EXPECT_EQ(policy_rows(session, 0)[1].xpu, "gpu0");
  session.scheduling = Scheduling::kRos2;
  EXPECT_EQ(policy_rows(session, 0)[1].xpu, "");
  EXPECT_EQ(policy_rows(session, 0)[1].xnode, "b");
}

}  // namespace
}  // namespace xauto::runtime

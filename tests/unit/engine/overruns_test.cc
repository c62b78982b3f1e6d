// SPDX-License-Identifier: Apache-2.0
// With tables: which jobs past a WCET what is claimed does not cover. Of docs/modes.md and theorem 8.
#include <gtest/gtest.h>

#include "session/claimed_wcets.h"

#include "test_app.h"
#include "tests/unit/tables_of.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kMsec = 1'000'000;

/// "nominal" and "cpu slow" have table 0, "npu slow" table 1, where b1 is on the CPU.
Session cpu_or_npu_slow() {
  Session session = TestApp().session;
  session.app.one_at_a_time = true;
  for (XNodeSpec& xnode : session.app.xnodes) xnode.wcet_us = {{"cpu", 2'000}, {"npu", 1'000}};
  Scenario cpu{"cpu slow"}, npu{"npu slow"};
  cpu.wcet_scale_pct["cpu"] = 300;
  npu.wcet_scale_pct["npu"] = 500;
  Tables tables;
  tables.scenarios = {Scenario{"nominal"}, cpu, npu};
  tables.tables = {
      test::table_of(session.app, "table 0", {0, 1, 1, 1}, {5'000, 10'000, 15'000, 20'000}),
      test::table_of(session.app, "table 1", {0, 1, 0, 1}, {7'000, 14'000, 21'000, 30'000})};
  for (const int table : {0, 0, 1}) test::serve(tables, session.app, table);
  session.take_tables(std::move(tables));
  return session;
}

TEST(ClaimedWcets, AScenarioClaimsSomethingOfJobsWithinItsOwn) {
  const Session session = cpu_or_npu_slow();
  const ClaimedWcets claimed(session);
  EXPECT_EQ(claimed.under(0, 0, 0), 2 * kMsec);
  EXPECT_EQ(claimed.under(1, 0, 0), 6 * kMsec);
  EXPECT_EQ(claimed.under(2, 0, 0), 2 * kMsec);
  EXPECT_EQ(claimed.under(2, 0, 2), 5 * kMsec) << "b1, on the NPU there";
  EXPECT_EQ(claimed.under(2, 1, 2), 2 * kMsec) << "and on the CPU there";
  EXPECT_EQ(claimed.least(0, 0), 2 * kMsec) << "of the two that table 0 serves";
  EXPECT_EQ(claimed.least(1, 1), 5 * kMsec) << "of the one that table 1 serves";
}

TEST(ClaimedWcets, AtARateATableClaimsSomethingOfJobsWithinAllThatItServes) {
  Session session = cpu_or_npu_slow();
  session.app.one_at_a_time = false;
  const ClaimedWcets claimed(session);
  EXPECT_EQ(claimed.under(0, 0, 0), 6 * kMsec);
  EXPECT_EQ(claimed.under(1, 0, 0), 6 * kMsec);
  EXPECT_EQ(claimed.under(2, 0, 0), 2 * kMsec);
  EXPECT_EQ(claimed.least(0, 0), 6 * kMsec);
  EXPECT_EQ(claimed.least(0, 1), 1 * kMsec);
}

TEST(ClaimedWcets, AnEmulatedJobMayTakeItsAllowanceAndNoStall) {
  Session session = cpu_or_npu_slow();
  session.presence = {Presence::kEmulated, Presence::kReal};
  const ClaimedWcets claimed(session);
  EXPECT_EQ(claimed.under(0, 0, 0), 2'140'000);
  EXPECT_EQ(claimed.under(0, 0, 1), kMsec);
}

/// a1 has 2 ms, and 20 s under "slow"; all others have a minute.
class OverrunUnderTables : public ::testing::Test {
 protected:
  OverrunUnderTables() {
    for (XNodeSpec& xnode : app_.session.app.xnodes)
      xnode.wcet_us = {{"cpu", 60'000'000}, {"npu", 60'000'000}};
    app_.session.app.xnodes[0].wcet_us = {{"cpu", 2'000}};
    app_.session.app.one_at_a_time = true;
    app_.session.deployment.tables.dwell_us = 60'000'000;  // nobody goes back
    slow_.wcet_us["a1"] = {{"cpu", 20'000'000}};
  }
  /// a1 takes `us` in release `at`.
  RunReport run(std::vector<Scenario> scenarios, std::uint64_t at, std::int64_t us) {
    Tables tables;
    tables.app = "test";
    tables.tables = {test::table_of(app_.session.app, "table 0", {0, 1, 1, 1},
                                    {60'000'000, 120'000'000, 180'000'000, 240'000'000})};
    for (const Scenario& scenario : scenarios) {
      (void)scenario;
      test::serve(tables, app_.session.app, 0);
    }
    tables.scenarios = std::move(scenarios);
    app_.session.take_tables(std::move(tables));
    app_.exec = [=](const std::string& node, std::uint64_t k) -> Status {
      if (node == "a1" && k == at) std::this_thread::sleep_for(std::chrono::microseconds(us));
      return {};
    };
    auto report = app_.run();
    EXPECT_TRUE(report) << (report ? "" : report.error().to_string());
    return report ? std::move(*report) : RunReport();
  }
  TestApp app_;
  Scenario slow_{"slow"};
};

TEST_F(OverrunUnderTables, WhatLedToAScenarioThatCoversItBreaksNothing) {
  const RunReport report = run({Scenario{"nominal"}, slow_}, 10, 5'000);
  EXPECT_EQ(report.num_switches, 1u);
  ASSERT_EQ(report.xnodes.size(), 4u);
  EXPECT_EQ(report.xnodes[0].jobs, 50u);
  EXPECT_GE(report.xnodes[0].longest_us, 5'000);
  EXPECT_EQ(report.xnodes[0].over_wcet, 0u);
  EXPECT_EQ(report.account.count_of("wcet_overrun"), 0u);
}

TEST_F(OverrunUnderTables, WhatNoReleaseFollowsIsCoveredByNone) {
  const RunReport report = run({Scenario{"nominal"}, slow_}, 49, 5'000);
  if (report.num_switches > 0) return;  // the machine stood still before
  ASSERT_EQ(report.xnodes.size(), 4u);
  EXPECT_EQ(report.xnodes[0].over_wcet, 1u);
  EXPECT_GE(report.xnodes[0].over_us, 3'000);
  const auto overrun =
      std::ranges::find(report.account.assumptions, "wcet_overrun", &Assumption::kind);
  ASSERT_NE(overrun, report.account.assumptions.end());
  ASSERT_TRUE(overrun->broken());
  EXPECT_TRUE(overrun->words.front().starts_with(
      "1 of 200 jobs outran the WCET of their scenario, a1 by "));
}

}  // namespace
}  // namespace xauto::runtime

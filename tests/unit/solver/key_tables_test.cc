// SPDX-License-Identifier: Apache-2.0
// Tables of keys: what is written is true, more tables are no worse, and a lie is found.
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "model/json.h"
#include "solver/tables.h"
#include "solver/verify_tables.h"

namespace xauto::solver {
namespace {

/// A camera at 50 Hz through CPU and GPU, or slowly through CPUs alone; a control loop at 100 Hz that
/// samples it.
AppSpec seeing_and_acting(bool two_clocks = false) {
  AppSpec app;
  app.version = 2;
  app.name = "two";
  app.clocks = {{"main", 0}, {"camera", two_clocks ? 100 : 0}};
  app.sources = {{"camera", {20'000}}, {"tick", {10'000}}};
  if (two_clocks) app.sources[0].clock = 1;
  app.modules = {{"see", 2, false}, {"act", 1, false}};
  app.xnodes = {{"pre", "see", {{"cpu", 1000}}, {0}},
                {"infer", "see", {{"gpu", 4000}, {"cpu", 12'000}}},
                {"plan", "act", {{"cpu", 900}}, {1}}};
  app.edges = {{0, 1}};
  app.samples = {{1, 2}};
  app.chains = {{"see", 0, 2, 60'000}, {"act", 1, 2, 10'000}};
  return app;
}

Platform of_two_cpus() {
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu"}, {"cpu1", "cpu"}, {"gpu0", "gpu", true, 50, 1000}};
  return platform;
}

Scenarios with_slower_gpus() {
  return {"two",
          {{.name = "nominal"},
           {.name = "slow", .wcet_scale_pct = {{"gpu", 200}}},
           {.name = "slower", .wcet_scale_pct = {{"gpu", 350}}},
           {.name = "no GPU", .lost = {"gpu0"}}}};
}

Result<Tables> few(const AppSpec& app, int count, bool with_loss = true) {
  Scenarios list = with_slower_gpus();
  if (!with_loss) list.list.pop_back();
  TablesOptions options;
  options.tables = count;
  options.time_limit_s = 1000;
  options.max_evaluations = 200;
  return solve_tables(app, of_two_cpus(), list, options);
}

TEST(KeyTables, AreTrueAndMoreOfThemAreNoWorse) {
  const AppSpec app = seeing_and_acting();
  double before = 1e9;
  for (const int count : {1, 2, 3}) {
    const auto tables = few(app, count);
    ASSERT_TRUE(tables) << tables.error().to_string();
    EXPECT_LE(tables->tables.size(), static_cast<std::size_t>(count));
    EXPECT_LE(tables->worst_regret(), before * 1.02);
    EXPECT_GE(tables->worst_regret(), 1);
    before = tables->worst_regret();
    const TablesVerification v = verify_tables(app, of_two_cpus(), *tables);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
    const auto read = parse_tables(to_json(*tables, app, of_two_cpus()), "t", app, of_two_cpus());
    ASSERT_TRUE(read) << read.error().to_string();
    EXPECT_EQ(read->handovers, tables->handovers);
    EXPECT_EQ(read->serves, tables->serves);
    // One that serves the lost GPU has nothing there.
    const auto& last = tables->tables[static_cast<std::size_t>(tables->serves[3].table)];
    for (const int xpu : last.xpu) EXPECT_NE(xpu, 2);
  }
}

TEST(KeyTables, EachLieIsFound) {
  const AppSpec app = seeing_and_acting();
  const Platform platform = of_two_cpus();
  const auto tables = few(app, 2);
  ASSERT_TRUE(tables) << tables.error().to_string();
  ASSERT_EQ(tables->tables.size(), 2u);
  const auto lies = [&](const Tables& of) { return verify_tables(app, platform, of).lies.size(); };
  ASSERT_EQ(lies(*tables), 0u);
  int claimed = 0;
  for (std::size_t h = 0; h < tables->handovers.size(); ++h)
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (!tables->handovers[h].worst_case_us[c]) continue;
      ++claimed;
      Tables bad = *tables;
      *bad.handovers[h].worst_case_us[c] -= 1 + *bad.handovers[h].worst_case_us[c] / 10;
      EXPECT_EQ(lies(bad), 1u) << h << ", " << c;
      bad = *tables;
      bad.handovers[h].settles_us /= 2;
      EXPECT_EQ(lies(bad), 1u) << h;
    }
  EXPECT_GT(claimed, 0);
  for (std::size_t t = 0; t < 2; ++t) {
    Tables bad = *tables;
    bad.keys[t].chains[0].worst_case_us -= 1;
    EXPECT_EQ(lies(bad), 1u) << t;
  }
  Tables bad = *tables;
  bad.serves[0].chain_bound_us[0] = 1'000'000;
  EXPECT_EQ(lies(bad), 1u);
}

TEST(KeyTables, ClocksThatCanHaveXpusOfTheirOwnDo) {
  const AppSpec app = seeing_and_acting(true);
  const auto tables = few(app, 2, false);
  ASSERT_TRUE(tables) << tables.error().to_string();
  EXPECT_TRUE(verify_tables(app, of_two_cpus(), *tables).truthful());
  EXPECT_EQ(tables->tables.size(), 2u);
  for (const Table& table : tables->tables) {
    EXPECT_NE(table.xpu[0], table.xpu[2]);
    EXPECT_NE(table.xpu[1], table.xpu[2]);
  }
  for (const Handover& h : tables->handovers) {
    EXPECT_FALSE(h.worst_case_us[0]) << "through two clocks";
    EXPECT_TRUE(h.worst_case_us[1]);
    EXPECT_FALSE(h.not_claimed.empty());
  }
}

TEST(KeyTables, WhatCannotBeIsRefused) {
  AppSpec app = seeing_and_acting();
  TablesOptions options;
  options.tables = 2;
  options.time_limit_s = 1000;
  options.max_evaluations = 200;
  Scenarios list = with_slower_gpus();
  list.list[1].degraded = true;
  const auto degraded = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(degraded);
  EXPECT_EQ(degraded.error().where, "/scenarios/1/degraded");
  list = with_slower_gpus();
  list.list[1].wcet_scale_pct = {{"cpu", 3000}};
  const auto overload = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(overload);
  EXPECT_EQ(overload.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(overload.error().to_string().find("no policy keeps up"), std::string::npos);
  EXPECT_NE(overload.error().to_string().find("slow"), std::string::npos);
}

}  // namespace
}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// What changes cost, and that tables are chosen by that, too.
#include "solver/keys/changes.h"

#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/json.h"
#include "solver/keys/check_tables.h"
#include "solver/keys/key_tables.h"

namespace xauto::solver::keys {
namespace {

/// Chains of 10 ms, and one without a deadline.
AppSpec with_three_chains() {
  AppSpec app;
  app.name = "three";
  app.sources = {{"tick", {10'000}}};
  app.modules = {{"m", 1, false}};
  app.xnodes = {{"x", "m", {{"cpu", 1000}}, {0}}};
  app.chains = {{"a", 0, 0, 10'000}, {"b", 0, 0, 10'000}, {"c", 0, 0, {}}};
  return app;
}

/// Two tables with worst cases of 8, 12 and 8 ms, and one change.
Tables with_change(std::optional<std::int64_t> a, std::optional<std::int64_t> b,
                   std::optional<std::int64_t> c, std::int64_t settles_us = 0) {
  Tables tables;
  for (int t = 0; t < 2; ++t) {
    tables.tables.emplace_back();
    tables.tables.back().keys.chains = {{"a", 8000}, {"b", 12'000}, {"c", 8000}};
    tables.scenarios.emplace_back();
    tables.serves.push_back({t});
  }
  tables.handovers = {{0, 1, {a, b, c}, settles_us}};
  return tables;
}

ChangeCost cost(const Tables& tables) {
  return cost_of(tables.handovers, tables, with_three_chains());
}

TEST(ChangeCost, WhatIsNotClaimedIsWorseThanAMissedDeadlineAndThatThanAnyLength) {
  const ChangeCost best = cost(with_change(8000, 12'000, 8000));
  EXPECT_EQ(best.unclaimed, 0);
  EXPECT_EQ(best.missed, 0);  // b misses its own in each table: that is not the change's
  const ChangeCost longer = cost(with_change(9999, 12'000, 80'000));
  EXPECT_EQ(longer.missed, 0);
  EXPECT_LT(best, longer);
  const ChangeCost missed = cost(with_change(10'500, 12'000, 8000));
  EXPECT_NEAR(missed.missed, 0.05, 1e-12);
  EXPECT_LT(longer, missed);
  EXPECT_NEAR(cost(with_change(10'500, 13'000, 8000)).missed, 0.05 + 0.1, 1e-12);
  const ChangeCost unclaimed = cost(with_change({}, 12'000, 8000));
  EXPECT_EQ(unclaimed.unclaimed, 1);
  EXPECT_LT(missed, unclaimed);
  EXPECT_LT(best, cost(with_change(8000, 12'000, 8000, 1'000'000)));
}

TEST(ChangeCost, OfAChainThatOneTableLacksNothingIsAsked) {
  Tables tables = with_change(8000, kNotThere, 8000);
  tables.tables[1].keys.chains[1].worst_case_us = kNotThere;
  const ChangeCost of = cost(tables);
  EXPECT_EQ(of.unclaimed, 0);
  EXPECT_EQ(of.missed, 0);
}

/// The driving case at three rates, nominal and with a slower GPU.
TEST(Changes, AmongEqualTablesThoseWithCheapChangesAreTaken) {
  const auto app = load_app(XAUTO_SOURCE_DIR "/examples/driving/rates.json");
  ASSERT_TRUE(app) << app.error().to_string();
  const Platform platform = *Platform::builtin("small");
  const Scenarios list{app->name,
                       {{.name = "nominal"}, {.name = "hot", .wcet_scale_pct = {{"gpu", 140}}}}};
  TablesOptions options;
  options.tables = 2;
  options.time_limit_s = 1000;
  options.max_evaluations = 400;
  double price = 0;
  for (const std::uint64_t seed : {6, 8}) {
    options.seed = seed;
    const auto tables = solve_key_tables(*app, platform, list, options);
    ASSERT_TRUE(tables) << tables.error().to_string();
    const ChangeCost cost = cost_of(tables->handovers, *tables, *app);
    // As first chosen, seed 8's changes lack four claims. Of seeds 1 to 10 all is claimed in 9, as first chosen in 6.
    EXPECT_EQ(cost.unclaimed, 0) << "seed " << seed;
    EXPECT_EQ(cost.missed, 0) << "seed " << seed;
    price += cost.price;
    const TablesReport v = examine_tables(*app, platform, *tables);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
  }
  EXPECT_LT(price, 1.27);  // as first chosen: 0.832 and 0.520; found: 0.689 and 0.561
}

/// Two scenarios that differ in nothing that matters: no second table, and so no change.
TEST(Changes, ATableThatIsHardlyBetterIsSpared) {
  AppSpec app = with_three_chains();
  app.xnodes.push_back({"y", "n", {{"cpu", 2000}, {"gpu", 1990}}, {0}});
  app.modules.push_back({"n", 1, false});
  app.chains.push_back({"d", 0, 1, 10'000});
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu"}, {"cpu1", "cpu"}, {"gpu0", "gpu", true, 50, 1000}};
  TablesOptions options;
  options.tables = 2;
  options.time_limit_s = 1000;
  options.max_evaluations = 200;
  Scenarios list{app.name,
                 {{.name = "nominal"}, {.name = "hot", .wcet_scale_pct = {{"gpu", 300}}}}};
  const auto one = solve_key_tables(app, platform, list, options);
  ASSERT_TRUE(one) << one.error().to_string();
  EXPECT_EQ(one->tables.size(), 1u);
  app.xnodes.back().wcet_us["gpu"] = 500;
  const auto two = solve_key_tables(app, platform, list, options);
  ASSERT_TRUE(two) << two.error().to_string();
  EXPECT_EQ(two->tables.size(), 2u);
}

}  // namespace
}  // namespace xauto::solver::keys

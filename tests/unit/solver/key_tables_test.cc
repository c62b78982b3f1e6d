// SPDX-License-Identifier: Apache-2.0
// Tables of keys: what is written is true, more tables are no worse, and a lie is found.
#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/json.h"
#include "solver/keys/check_tables.h"
#include "solver/tables.h"

namespace xauto::solver {
namespace {

/// A camera at 50 Hz through CPU and GPU, or slowly through CPUs alone; a control loop at 100 Hz that
/// samples it.
AppSpec seeing_and_acting(bool two_clocks = false) {
  AppSpec app;
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

TablesOptions ended_by_evaluations(int tables, int evaluations = 200) {
  TablesOptions options;
  options.tables = tables;
  options.time_limit_s = 1000;
  options.max_evaluations = evaluations;
  return options;
}

Result<Tables> few(const AppSpec& app, int count, bool with_loss = true) {
  Scenarios list = with_slower_gpus();
  if (!with_loss) list.list.pop_back();
  const TablesOptions options = ended_by_evaluations(count);
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
    const keys::TablesReport v = keys::examine_tables(app, of_two_cpus(), *tables);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
    const auto read = parse_tables(to_json(*tables, app, of_two_cpus()), "t", app, of_two_cpus());
    ASSERT_TRUE(read) << read.error().to_string();
    EXPECT_EQ(read->handovers, tables->handovers);
    EXPECT_EQ(read->serves, tables->serves);
    // One that serves the lost GPU has nothing there.
    const auto& last = tables->tables[static_cast<std::size_t>(tables->serves[3].table)];
    for (const Placement& placed : last.keys.placements) EXPECT_NE(placed.xpu, 2);
  }
}

/// Which scenarios share a table: the least regret of so many tables, of every way to divide the scenarios,
/// each part solved by itself with the same budget.
double least_of_all_sets(const AppSpec& app, const Platform& platform, const Scenarios& list,
                         int tables) {
  const std::size_t n = list.list.size();
  std::vector<double> of_set(std::size_t{1} << n, 0);
  for (std::size_t set = 1; set < of_set.size(); ++set) {
    Scenarios part{list.app, {}};
    for (std::size_t s = 0; s < n; ++s)
      if ((set >> s & 1) != 0) part.list.push_back(list.list[s]);
    const auto one = solve_tables(app, platform, part, ended_by_evaluations(1));
    of_set[set] = one ? one->worst_regret() : 1e9;
  }
  double least = 1e9;
  std::vector<int> table_of(n, 0);
  for (std::size_t i = 0; i < n;) {
    double worst = 0;
    for (int t = 0; t < tables; ++t) {
      std::size_t set = 0;
      for (std::size_t s = 0; s < n; ++s) set |= std::size_t{table_of[s] == t} << s;
      worst = std::max(worst, of_set[set]);
    }
    least = std::min(least, worst);
    for (i = 0; i < n && ++table_of[i] == tables; ++i) table_of[i] = 0;
  }
  return least;
}

TEST(KeyTables, NoOtherSetsOfScenariosAreBetter) {
  Scenarios list = with_slower_gpus();
  list.list.pop_back();
  const auto two = solve_tables(seeing_and_acting(), of_two_cpus(), list, ended_by_evaluations(2));
  ASSERT_TRUE(two) << two.error().to_string();
  EXPECT_LE(two->worst_regret(),
            least_of_all_sets(seeing_and_acting(), of_two_cpus(), list, 2) * 1.02);
}

/// Of three tables two scenarios that do not limit share one, so that each other one has its own.
TEST(KeyTables, ScenariosThatDoNotLimitAreJoinedForThoseThatDo) {
  AppSpec app;
  app.name = "nets";
  app.sources = {{"fast", {20'000}}, {"slow", {40'000}}};
  app.modules = {{"a", 1, false}, {"b", 1, false}, {"f", 1, false}};
  app.xnodes = {{"a", "a", {{"cpu", 3079}, {"dla", 970}, {"gpu", 700}}, {0}},
                {"b", "b", {{"dla", 496}, {"gpu", 714}}, {1}},
                {"fuse", "f", {{"cpu", 300}}}};
  app.edges = {{0, 2}};
  app.chains = {{"b", 1, 1, 6069}, {"fused", 0, 2, 7640}};
  Platform platform;
  platform.name = "three";
  platform.xpus = {{"cpu0", "cpu", true, 50}, {"gpu0", "gpu"}, {"dla0", "dla"}};
  const Scenarios list{
      "nets",
      {{.name = "nominal"},
       {.name = "15 W", .wcet_scale_pct = {{"cpu", 180}, {"dla", 150}, {"gpu", 310}}},
       {.name = "30 W", .wcet_scale_pct = {{"gpu", 170}}},
       {.name = "hot", .wcet_scale_pct = {{"cpu", 130}, {"dla", 250}}}}};
  const auto three = solve_tables(app, platform, list, ended_by_evaluations(3));
  ASSERT_TRUE(three) << three.error().to_string();
  EXPECT_LE(three->worst_regret(), least_of_all_sets(app, platform, list, 3) * 1.001);
}

TEST(KeyTables, EachLieIsFound) {
  const AppSpec app = seeing_and_acting();
  const Platform platform = of_two_cpus();
  const auto tables = few(app, 2);
  ASSERT_TRUE(tables) << tables.error().to_string();
  ASSERT_EQ(tables->tables.size(), 2u);
  const auto lies = [&](const Tables& of) {
    return keys::examine_tables(app, platform, of).lies.size();
  };
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
    bad.tables[t].keys.chains[0].worst_case_us -= 1;
    EXPECT_EQ(lies(bad), 1u) << t;
  }
  Tables bad = *tables;
  bad.serves[0].chain_bound_us[0] = 1'000'000;
  EXPECT_EQ(lies(bad), 1u);
}

/// Beside these a display, which the app can do without, and a net that is smaller.
AppSpec that_can_do_without() {
  AppSpec app = seeing_and_acting();
  app.modules.push_back({"show", 2, true});
  app.xnodes[1].variants = {{"small", 60, {{"gpu", 1500}, {"cpu", 5000}}}};
  app.xnodes.push_back({"draw", "show", {{"cpu", 15'000}}});
  app.xnodes.push_back({"screen", "show", {{"gpu", 500}, {"cpu", 9000}}});
  app.edges.push_back({1, 3});
  app.edges.push_back({3, 4});
  app.chains.push_back({"show", 0, 4, 60'000});
  return app;
}

TEST(KeyTables, WhereItIsDegradedTheAppLosesWhatItMustAndNowhereElse) {
  const AppSpec app = that_can_do_without();
  const Platform platform = of_two_cpus();
  Scenarios list{"two",
                 {{.name = "nominal"},
                  {.name = "hot", .wcet_scale_pct = {{"gpu", 400}, {"cpu", 210}}, .degraded = true},
                  {.name = "no GPU", .lost = {"gpu0"}, .degraded = true}}};
  const TablesOptions options = ended_by_evaluations(3);
  const auto tables = solve_tables(app, platform, list, options);
  ASSERT_TRUE(tables) << tables.error().to_string();
  const auto table = [&](int s) { return static_cast<std::size_t>(tables->serves[at(s)].table); };
  EXPECT_TRUE(tables->tables[table(0)].loss.none());
  for (const int s : {1, 2}) {
    const Table& less = tables->tables[table(s)];
    EXPECT_FALSE(less.loss.none());
    EXPECT_NE(less.name.find(words_of(less.loss, app)), std::string::npos) << less.name;
    for (const ChainClaim& claim : tables->tables[table(s)].keys.chains)
      EXPECT_LE(claim.worst_case_us, 60'000) << less.name << ", " << claim.name;
  }
  // It takes longer than its period; and without the GPU the smaller net is enough.
  EXPECT_TRUE(tables->tables[table(1)].loss.is_off("show"));
  EXPECT_EQ(tables->tables[table(1)].keys.chains[2].worst_case_us, kNotThere);
  EXPECT_EQ(tables->serves[1].chain_bound_us[2], kNotThere);
  EXPECT_EQ(words_of(tables->tables[table(2)].loss, app), "infer small");
  const keys::TablesReport v = keys::examine_tables(app, platform, *tables);
  EXPECT_TRUE(v.truthful()) << v.lies.front();
  int meanwhile = 0;
  for (const Handover& h : tables->handovers) {
    if (h.worst_case_us[2]) {
      EXPECT_EQ(*h.worst_case_us[2] != kNotThere, both_have(*tables, h.from, h.to, 2));
    }
    meanwhile += h.worst_case_us[1].has_value();
  }
  EXPECT_GE(meanwhile, 2) << "control is not off, nor what it takes during a change";
  const auto read = parse_tables(to_json(*tables, app, platform), "t", app, platform);
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->tables, tables->tables);
  EXPECT_EQ(read->handovers, tables->handovers);
  const auto lies = [&](const auto& spoil) {
    Tables bad = *tables;
    spoil(bad, bad.tables[table(1)]);
    return !keys::examine_tables(app, platform, bad).truthful();
  };
  EXPECT_TRUE(lies([](Tables& t, Table&) { t.scenarios[1].degraded = false; }));
  EXPECT_TRUE(lies([&](Tables& t, Table&) { t.serves[0].table = t.serves[1].table; }));
  EXPECT_TRUE(lies([](Tables&, Table& less) { less.loss = {}; }))
      << "it has no place for the screen";
  EXPECT_TRUE(lies([](Tables&, Table& less) { less.loss.off = {"see", "show"}; })) << "is needed";
  EXPECT_TRUE(
      lies([&](Tables& t, Table&) { t.tables[table(1)].keys.chains[2].worst_case_us = 50'000; }));
  EXPECT_TRUE(lies(
      [&](Tables& t, Table&) { t.tables[table(1)].keys.chains[1].worst_case_us = kNotThere; }));
  for (std::size_t h = 0; h < tables->handovers.size(); ++h) {
    if (!tables->handovers[h].claims_all()) continue;  // from the GPU that is lost
    EXPECT_TRUE(lies([&](Tables& t, Table&) { t.handovers[h].settles_us /= 2; })) << h;
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (tables->handovers[h].worst_case_us[c].value_or(kNotThere) == kNotThere) continue;
      EXPECT_TRUE(lies([&](Tables& t, Table&) {
        *t.handovers[h].worst_case_us[c] -= *t.handovers[h].worst_case_us[c] / 5;
      })) << h
          << ", " << c;
    }
  }
}

/// The display's XPU is gone: where it is degraded the display is off, and elsewhere that is no scenario.
TEST(KeyTables, WhatCanRunNowhereIsOffWhereItMayBe) {
  AppSpec app = that_can_do_without();
  app.xnodes[4].wcet_us.erase("cpu");
  app.xnodes[1].wcet_us.erase("cpu");  // its variant is left
  Scenarios list{"two", {{.name = "nominal"}, {.name = "no GPU", .lost = {"gpu0"}}}};
  const TablesOptions options = ended_by_evaluations(2);
  const auto refused = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().hint,
            "let it be degraded, and it is possible with show off, infer small");
  list.list[1].degraded = true;
  const auto tables = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_TRUE(tables) << tables.error().to_string();
  const Table& less = tables->tables[at(tables->serves[1].table)];
  EXPECT_EQ(words_of(less.loss, app), "show off, infer small");
  EXPECT_EQ(forced_loss(app, platform_under(of_two_cpus(), list.list[1])), less.loss);
  const keys::TablesReport v = keys::examine_tables(app, of_two_cpus(), *tables);
  EXPECT_TRUE(v.truthful()) << v.lies.front();
  EXPECT_TRUE(parse_tables(to_json(*tables, app, of_two_cpus()), "t", app, of_two_cpus()));
  // A module that is not optional has to have a place.
  app.modules[2].optional = false;
  const auto none = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().where, "/scenarios/1");
}

TEST(KeyTables, NothingSaysForWhatAnythingIsLostWithoutDeadlines) {
  AppSpec app = that_can_do_without();
  for (ChainSpec& chain : app.chains) chain.deadline_us.reset();
  Scenarios list{"two", {{.name = "nominal"}, {.name = "hot", .degraded = true}}};
  TablesOptions options;
  options.tables = 2;
  const auto tables = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(tables);
  EXPECT_EQ(tables.error().where, "/scenarios/1/degraded");
}

TEST(KeyTables, ClocksThatCanHaveXpusOfTheirOwnDo) {
  const AppSpec app = seeing_and_acting(true);
  const auto tables = few(app, 2, false);
  ASSERT_TRUE(tables) << tables.error().to_string();
  EXPECT_TRUE(keys::examine_tables(app, of_two_cpus(), *tables).truthful());
  EXPECT_EQ(tables->tables.size(), 2u);
  for (const Table& table : tables->tables) {
    EXPECT_NE(table.xpu(0), table.xpu(2));
    EXPECT_NE(table.xpu(1), table.xpu(2));
  }
  for (const Handover& h : tables->handovers) {
    EXPECT_TRUE(h.claims_all());  // a chain through both clocks, too
    EXPECT_TRUE(h.not_claimed.empty());
  }
  for (std::size_t c = 0; c < app.chains.size(); ++c) {
    Tables lying = *tables;
    *lying.handovers[0].worst_case_us[c] -= *lying.handovers[0].worst_case_us[c] / 5;
    EXPECT_FALSE(keys::examine_tables(app, of_two_cpus(), lying).truthful()) << c;
  }
  // What settles last is the camera's clock: who claims nothing of it need not say so.
  Tables lying = *tables;
  lying.handovers[0].settles_us -= 10;
  EXPECT_FALSE(keys::examine_tables(app, of_two_cpus(), lying).truthful());
  lying.handovers[0].worst_case_us[0].reset();
  lying.handovers[0].not_claimed = {"the camera's clock"};
  EXPECT_TRUE(keys::examine_tables(app, of_two_cpus(), lying).truthful());
}

TEST(KeyTables, WhatCannotBeIsRefused) {
  AppSpec app = seeing_and_acting();
  const TablesOptions options = ended_by_evaluations(2);
  Scenarios list = with_slower_gpus();
  list.list[1].wcet_scale_pct = {{"cpu", 3000}};
  const auto overload = solve_tables(app, of_two_cpus(), list, options);
  ASSERT_FALSE(overload);
  EXPECT_EQ(overload.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(overload.error().to_string().find("no policy keeps up"), std::string::npos);
  EXPECT_NE(overload.error().to_string().find("slow"), std::string::npos);
}

}  // namespace
}  // namespace xauto::solver

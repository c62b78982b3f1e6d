// SPDX-License-Identifier: Apache-2.0
#include "model/app.h"

#include <gtest/gtest.h>

#include "model/contention.h"
#include "model/json.h"
#include "model/periodic.h"
#include "model/profile.h"
#include "model/scenario.h"
#include "model/tables.h"

#include "tests/unit/tables_of.h"

namespace xauto {
namespace {

AppSpec chain(int length) {
  AppSpec app;
  app.name = "chain";
  app.one_at_a_time = true;
  app.sources = {{"s", kNoRate}};
  for (int i = 0; i < length; ++i) {
    app.xnodes.push_back({"n" + std::to_string(i), "M", {{"cpu", 100 + i}}});
    if (i > 0) app.edges.emplace_back(i - 1, i);
  }
  app.xnodes[0].sources = {0};
  complete_modules(app);
  complete_chains(app);
  return app;
}

TEST(AppSpec, TopologicalOrderTakesTheSmallestIndexFirst) {
  AppSpec app = chain(1);
  for (int i = 1; i < 5; ++i) app.xnodes.push_back({"n" + std::to_string(i), "M", {{"cpu", 1}}});
  app.edges = {{4, 0}, {3, 1}};
  EXPECT_EQ(app.topological_order(), (std::vector<int>{2, 3, 1, 4, 0}));
}

TEST(AppSpec, CycleIsNamedInTheDirectionOfItsEdges) {
  AppSpec app = chain(5);
  app.edges.emplace_back(3, 1);
  const auto status = validate(app);
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().what.find("'n1' -> 'n2' -> 'n3' -> 'n1'"), std::string::npos)
      << status.error().what;
  EXPECT_EQ(status.error().what.find("n4"), std::string::npos)
      << "n4 is behind the cycle, not on it";
}

TEST(AppSpec, HashChangesWithEveryThingThatAPolicyDependsOn) {
  const AppSpec app = chain(3);
  std::vector<AppSpec> others(7, app);
  others[0].name = "other";
  others[1].xnodes[1].name = "m1";
  others[2].xnodes[1].module = "N";
  others[3].xnodes[1].wcet_us["cpu"] = 7;
  others[4].xnodes[1].wcet_us["gpu"] = 7;
  others[5].edges.pop_back();
  others[6].deadline_us = 1000;
  for (const AppSpec& other : others) EXPECT_NE(other.hash(), app.hash());
  EXPECT_EQ(chain(3).hash(), app.hash());
}

TEST(AppSpec, HashKeepsNeighbouringNamesApart) {
  AppSpec a = chain(1), b = chain(1);
  a.xnodes[0].name = "ab", a.xnodes[0].module = "c";
  b.xnodes[0].name = "a", b.xnodes[0].module = "bc";
  EXPECT_NE(a.hash(), b.hash());
}

TEST(AppSpec, XNodeThatThePlatformCannotRunIsInfeasibleNotInvalid) {
  AppSpec app = chain(2);
  app.xnodes[1].wcet_us = {{"npu", 10}};
  ASSERT_TRUE(validate(app));
  const auto status = validate_on(app, Platform::builtin("small").value());
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(status.error().what.find("'n1' runs on npu only"), std::string::npos);
}

TEST(AppSpec, LimitsHold) {
  AppSpec app = chain(2);
  app.xnodes[0].wcet_us["cpu"] = kMaxTimeUs;
  EXPECT_TRUE(validate(app));
  app.xnodes[0].wcet_us["cpu"] = kMaxTimeUs + 1;
  EXPECT_FALSE(validate(app));
  EXPECT_FALSE(validate(chain(static_cast<int>(kMaxXNodes) + 1)));
  app = chain(2);
  app.edges = {{0, 2}};
  EXPECT_FALSE(validate(app));
  app.edges = {{-1, 0}};
  EXPECT_FALSE(validate(app));
}

TEST(Platform, BuiltInsAreThePapers) {
  const Platform small = Platform::builtin("small").value(),
                 large = Platform::builtin("large").value();
  EXPECT_EQ(small.instances_of("cpu").size(), 4u);
  EXPECT_EQ(small.instances_of("gpu").size(), 1u);
  EXPECT_EQ(small.instances_of("dla").size(), 1u);
  EXPECT_EQ(large.instances_of("cpu").size(), 8u);
  EXPECT_EQ(large.instances_of("dla").size(), 2u);
  EXPECT_EQ(small.xpus[static_cast<std::size_t>(small.find("gpu0"))].preempt_us, 275);
  EXPECT_EQ(small.xpus[static_cast<std::size_t>(small.find("dla0"))].preempt_us, 132);
  EXPECT_TRUE(validate(small));
  EXPECT_TRUE(validate(large));
  EXPECT_FALSE(Platform::builtin("huge"));
  const Platform intel = Platform::builtin("core-ultra").value();
  EXPECT_TRUE(validate(intel));
  EXPECT_EQ(intel.instances_of("cpu").size(), 6u);
  EXPECT_EQ(intel.xpus[static_cast<std::size_t>(intel.find("gpu0"))].levels, 3);
  EXPECT_FALSE(intel.xpus[static_cast<std::size_t>(intel.find("npu0"))].preemptive);
  // Boards by their data sheets: CPUs, DLAs, PVAs; the paper measured on an Orin alone.
  const std::tuple<const char*, std::size_t, std::size_t, std::size_t> boards[] = {
      {"orin", 12, 2, 1},
      {"orin-nx", 8, 2, 1},
      {"orin-nano", 6, 0, 0},
      {"xavier", 8, 2, 1},
      {"thor", 14, 0, 1}};
  for (const auto& [name, cpus, dlas, pvas] : boards) {
    const Platform board = Platform::builtin(name).value();
    EXPECT_TRUE(validate(board)) << name;
    EXPECT_EQ(board.instances_of("cpu").size(), cpus) << name;
    EXPECT_EQ(board.instances_of("dla").size(), dlas) << name;
    EXPECT_EQ(board.instances_of("pva").size(), pvas) << name;
    EXPECT_EQ(board.instances_of("vic").size(), 1u) << name;
    const Xpu& gpu = board.xpus[static_cast<std::size_t>(board.find("gpu0"))];
    EXPECT_EQ(unmeasured(gpu).empty(), name == std::string("orin")) << name;
    EXPECT_TRUE(unmeasured(board.xpus[static_cast<std::size_t>(board.find("vic0"))]).empty());
    EXPECT_EQ(parse_platform(to_json(board), "board").value(), board) << name;
  }
}

TEST(Profile, WcetIsTheWorstInstancesMaxPlusMarginRoundedUp) {
  const Platform platform = Platform::builtin("small").value();
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.margin_pct = 20;
  profile.xnodes = {
      {"x",
       "M",
       {{"cpu0", {100, 1, 2, 3, 101}}, {"cpu1", {100, 1, 2, 4, 52}}, {"gpu0", {100, 0, 0, 0, 0}}}}};
  profile.xnodes[0].sources = {0};
  const AppSpec app = to_app(profile, platform, WcetFrom::kMaxPlusMargin).value();
  EXPECT_EQ(app.xnodes[0].wcet_on("cpu"), 122);  // 121.2
  EXPECT_EQ(app.xnodes[0].wcet_on("gpu"), 1) << "an XNode takes at least a microsecond";
  EXPECT_EQ(to_app(profile, platform, WcetFrom::kP99)->xnodes[0].wcet_on("cpu"), 4);
  EXPECT_EQ(to_app(profile, platform, WcetFrom::kP50)->xnodes[0].wcet_on("cpu"), 2);
}

TEST(Profile, FewSamplesHaveNoP99) {
  const Platform platform = Platform::builtin("small").value();
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.xnodes = {{"x", "M", {{"cpu0", {99, 1, 2, 3, 4}}}}};
  profile.xnodes[0].sources = {0};
  EXPECT_FALSE(to_app(profile, platform, WcetFrom::kP99));
  profile.xnodes[0].on["cpu0"].count = 100;
  EXPECT_TRUE(to_app(profile, platform, WcetFrom::kP99));
}

TEST(Profile, WithoutSourcesOneWithoutARateFiresWhatNobodyElseDoes) {
  Profile profile;
  profile.app = "a";
  profile.xnodes = {{"x", "M", {{"cpu0", {9, 1, 2, 3, 4}}}},
                    {"y", "N", {{"cpu0", {9, 1, 2, 3, 4}}}},
                    {"z", "O", {{"cpu0", {9, 1, 2, 3, 4}}}}};
  profile.edges = {{0, 2}, {1, 2}};
  const auto app = to_app(profile, Platform::builtin("small").value(), WcetFrom::kP50);
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_TRUE(app->one_at_a_time);
  ASSERT_EQ(app->sources.size(), 1u);
  EXPECT_EQ(app->xnodes[0].sources, (std::vector<int>{0}));
  EXPECT_EQ(app->xnodes[1].sources, (std::vector<int>{0}));
  EXPECT_EQ(app->xnodes[2].sources, (std::vector<int>{}));
  EXPECT_EQ(app->chains.size(), 1u);
}

TEST(Profile, WhereItWasNoStandInItIsReal) {
  const Platform platform = Platform::builtin("small").value();
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.xnodes = {{"x", "M", {{"cpu0", {9, 1, 2, 3, 4}}, {"gpu0", {9, 1, 2, 3, 4}}}}};
  profile.xnodes[0].sources = {0};
  profile.xnodes[0].on["gpu0"].emulated = true;
  const AppSpec app = to_app(profile, platform, WcetFrom::kMaxPlusMargin).value();
  EXPECT_EQ(app.xnodes[0].real_on, (std::set<std::string, std::less<>>{"cpu"}));
  const auto read = parse_app(to_json(app), "app.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, app);
}

/// By type the most of its instances; of a type of which nothing is known there is no number.
TEST(Profile, WhatInitAddedToTheMemoryIsToldByType) {
  const Platform platform = Platform::builtin("small").value();
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  const Samples samples{9, 1, 2, 3, 4};
  profile.xnodes = {{"x", "M", {{"cpu0", samples}, {"cpu1", samples}, {"gpu0", samples}}}};
  profile.xnodes[0].sources = {0};
  profile.xnodes[0].on["cpu0"].memory_kb = 0;
  profile.xnodes[0].on["cpu1"].memory_kb = 2048;
  profile.xnodes[0].variants = {{"small", 50, {{"gpu0", samples}}}};
  profile.xnodes[0].variants[0].on["gpu0"].memory_kb = 7;
  const auto again = parse_profile(to_json(profile), "profile.json");
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, profile);
  const AppSpec app = to_app(profile, platform, WcetFrom::kMaxPlusMargin).value();
  using Kb = std::map<std::string, std::int64_t, std::less<>>;
  EXPECT_EQ(app.xnodes[0].memory_kb, (Kb{{"cpu", 2048}}));
  EXPECT_EQ(app.xnodes[0].variants[0].memory_kb, (Kb{{"gpu", 7}}));
  const auto read = parse_app(to_json(app), "app.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, app);
  AppSpec without = app;
  without.xnodes[0].memory_kb.clear();
  EXPECT_EQ(without.hash(), app.hash()) << "a policy does not depend on it";
}

/// By type the longest median, whatever becomes the WCET.
TEST(Profile, TheMedianIsTheTypicalTime) {
  const Platform platform = Platform::builtin("small").value();
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.xnodes = {{"x", "M", {{"cpu0", {200, 1, 2, 9, 90}}, {"cpu1", {200, 1, 3, 9, 9}}}}};
  profile.xnodes[0].sources = {0};
  profile.xnodes[0].beside["gpu"]["cpu0"] = {200, 1, 4, 8, 9};
  profile.xnodes[0].variants = {{"small", 50, {{"gpu0", {200, 0, 0, 8, 9}}}}};
  for (const WcetFrom from : {WcetFrom::kMaxPlusMargin, WcetFrom::kP99, WcetFrom::kP50}) {
    const AppSpec app = to_app(profile, platform, from).value();
    EXPECT_EQ(app.xnodes[0].typical_us, (TypicalTimes{{"cpu", 3}})) << "alone";
    EXPECT_EQ(app.xnodes[0].variants[0].typical_us, (TypicalTimes{{"gpu", 1}}));
    const auto read = parse_app(to_json(app), "app.json");
    ASSERT_TRUE(read) << read.error().to_string();
    EXPECT_EQ(*read, app);
    AppSpec without = app;
    without.xnodes[0].typical_us.clear();
    without.xnodes[0].variants[0].typical_us.clear();
    EXPECT_EQ(without.hash(), app.hash()) << "a policy does not depend on it";
  }
}

/// An XNode on the built-in platform `small` (2 cpu, 1 gpu, 1 dla), measured beside loads.
TEST(AppSpec, WhatWasMeasuredBesideLoadsIsStated) {
  const Platform platform = Platform::builtin("small").value();
  const auto cpus = static_cast<std::int64_t>(platform.instances_of("cpu").size());
  Profile profile;
  profile.app = "a";
  profile.margin_pct = 0;
  profile.sources = {{"s", {1000}}};
  profile.xnodes = {{"x", "M", {{"gpu0", {200, 1, 2, 9, 10}}}}};
  profile.xnodes[0].sources = {0};
  auto& beside = profile.xnodes[0].beside;
  beside["cpu"]["gpu0"] = {200, 1, 4, 8, 14};
  beside["dla"]["gpu0"] = {200, 1, 2, 8, 9};  // by chance shorter than alone
  const auto app = [&] { return to_app(profile, platform, WcetFrom::kMaxPlusMargin).value(); };
  const auto dlas = static_cast<std::int64_t>(platform.instances_of("dla").size());
  const std::vector<BesideSpec> single = {{"gpu", {{"cpu", cpus}}, 14},
                                          {"gpu", {{"dla", dlas}}, 10}};
  EXPECT_EQ(app().xnodes[0].wcet_us.at("gpu"), 10);
  EXPECT_EQ(app().xnodes[0].beside, single);
  EXPECT_FALSE(wcet_beside(app().xnodes[0], "gpu", {{"cpu", 1}, {"dla", 1}}));
  beside["*"]["gpu0"] = {200, 1, 4, 8, 20};
  const AppSpec all = app();
  EXPECT_EQ(wcet_beside(all.xnodes[0], "gpu", {{"cpu", 1}, {"dla", 1}}), 20);
  EXPECT_EQ(wcet_beside(all.xnodes[0], "gpu", {{"cpu", 1}}), 14);
  EXPECT_EQ(wcet_beside(all.xnodes[0], "gpu", {{"pva", 3}}), 10) << "a type that is not stated";
  EXPECT_FALSE(wcet_beside(all.xnodes[0], "gpu", {{"cpu", cpus + 1}}));
  EXPECT_EQ(at_longest(all).xnodes[0].wcet_us.at("gpu"), 20);
  EXPECT_TRUE(at_longest(all).xnodes[0].beside.empty());
  const auto read = parse_app(to_json(all), "app.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, all);
  AppSpec other = all;
  other.xnodes[0].beside[0].wcet_us += 1;
  EXPECT_NE(other.hash(), all.hash());
  std::swap(other.xnodes[0].beside[0], other.xnodes[0].beside[1]);
  other.xnodes[0].beside[1].wcet_us -= 1;
  EXPECT_EQ(other.hash(), all.hash()) << "in any order";
}

TEST(AppSpec, EachLoadThatTheAppCanBeOnThePlatformHasToBeStated) {
  const Platform platform{"p", {{"gpu0", "gpu"}, {"dla0", "dla"}, {"dla1", "dla"}}};
  AppSpec app = chain(3);
  app.xnodes[0].wcet_us = {{"gpu", 10}};
  app.xnodes[1].wcet_us = app.xnodes[2].wcet_us = {{"dla", 10}};
  app.xnodes[0].beside = {{"gpu", {{"dla", 1}}, 12}};
  const auto refused = validate_on(app, platform);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().what.find("beside 2 dla"), std::string::npos);
  app.xnodes[2].wcet_us = {{"gpu", 10}};
  EXPECT_TRUE(validate_on(app, platform)) << "one XNode for DLAs loads one";
  app.xnodes[2].wcet_us = {{"dla", 10}};
  app.xnodes[0].beside.push_back({"gpu", {{"dla", 2}}, 19});
  EXPECT_TRUE(validate_on(app, platform));
  EXPECT_EQ(wcet_beside(app.xnodes[0], "gpu", {{"dla", 1}}), 12) << "the least that covers it";
  // A scenario scales the longest.
  EXPECT_EQ(app_under(app, {"slow", {{"gpu", 200}}}).xnodes[0].wcet_us.at("gpu"), 38);
}

TEST(Tables, TheMemoryOfAllInstancesCountsEachOnce) {
  const Platform platform = Platform::builtin("small").value();
  const int cpu0 = platform.find("cpu0"), cpu1 = platform.find("cpu1"),
            gpu0 = platform.find("gpu0");
  AppSpec app = chain(2);
  app.xnodes[0].wcet_us["gpu"] = 50;
  app.xnodes[0].memory_kb = {{"cpu", 100}, {"gpu", 3000}};
  app.xnodes[0].variants = {{"small", 50, {{"cpu", 1}}, {{"cpu", 20}}}};
  Tables tables;
  const auto table = [&](const std::vector<int>& xpu, Loss loss = {}) {
    return test::table_of(app, "t", xpu, {1, 2}, std::move(loss));
  };
  tables.tables = {table({cpu0, cpu0}), table({gpu0, cpu0}), table({cpu0, cpu1})};
  const auto memory = [&] { return memory_of_instances(tables, app, platform); };
  EXPECT_EQ(instances(tables), 4u);
  EXPECT_EQ(memory().kb, 3100) << "nobody knows of n1";
  EXPECT_EQ(memory().measured, 2u);
  tables.tables.push_back(table({cpu0, -1}, {{0, -1}, {}}));
  EXPECT_EQ(memory().kb, 3120);
  app.xnodes[1].memory_kb = {{"cpu", 0}};
  EXPECT_EQ(memory().measured, instances(tables)) << "measured, and nothing";
  EXPECT_EQ(memory().kb, 3120);
}

TEST(Profile, WhatComesBackIsNoOutlier) {
  std::vector<std::int64_t> us(30, 100);
  us[16] = 1000;
  Samples s = summarise(us);
  EXPECT_EQ(s.max_at, 17);
  EXPECT_TRUE(s.spread());
  EXPECT_FALSE(s.outlier) << "nobody asked";
  EXPECT_FALSE(summarise(us, 90).outlier) << "13 samples after it are too few";
  us.insert(us.end(), 90, 120);
  s = summarise(us, 90);
  ASSERT_TRUE(s.outlier);
  EXPECT_EQ(*s.outlier, (Outlier{1, 120, 103}));
  EXPECT_EQ(s.max_us, 1000) << "what was seen is never dropped";
  EXPECT_EQ(statistic(s, WcetFrom::kMaxPlusMargin, 20), 144);
  us.back() = 900;
  s = summarise(us, 90);
  EXPECT_FALSE(s.outlier);
  EXPECT_EQ(statistic(s, WcetFrom::kMaxPlusMargin, 20), 1200);
  // At twice the median nothing is wide.
  us = {100, 100, 200};
  EXPECT_FALSE(summarise(us).spread());
}

TEST(Profile, IncompleteOnesAreReadAsWritten) {
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.conditions.emulated = true;
  profile.incomplete = "stopped by the user";
  profile.xnodes = {
      {"x", "M", {{"cpu0", {9, 1, 2, 3, 4}}, {"cpu1", {9, 1, 2, 3, 40}}}, {}, {"gpu0"}}};
  profile.xnodes[0].sources = {0};
  profile.xnodes[0].on["cpu0"].emulated = true;
  profile.xnodes[0].on["cpu1"].max_at = 3;
  profile.xnodes[0].on["cpu1"].outlier = Outlier{1, 4, 6};
  const auto read = parse_profile(to_json(profile), "profile.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, profile);
  const auto app = to_app(*read, Platform::builtin("small").value(), WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_EQ(parse_app(to_json(*app), "app.json")->incomplete, "stopped by the user");
}

TEST(Profile, InstanceThatThePlatformLacksIsNamed) {
  Profile profile;
  profile.app = "a";
  profile.sources = {{"s", {1000}}};
  profile.xnodes = {{"x", "M", {{"npu3", {9, 1, 2, 3, 4}}}}};
  profile.xnodes[0].sources = {0};
  const auto app = to_app(profile, Platform::builtin("small").value(), WcetFrom::kP99);
  ASSERT_FALSE(app);
  EXPECT_NE(app.error().to_string().find("npu3"), std::string::npos);
}

/// camera (30 Hz) -> a -> b, lidar (10 Hz) -> c.
Profile of_two_rates() {
  Profile p;
  p.app = "p";
  const Samples samples{9, 1, 2, 3, 4};
  p.sources = {{"camera", *Period::of_rate("30")}, {"lidar", {100'000}}};
  p.xnodes = {{"a", "m", {{"cpu0", samples}}, {0}},
              {"b", "m", {{"cpu0", samples}}},
              {"c", "n", {{"cpu0", samples}}, {1}}};
  p.edges = {{0, 1}};
  p.asks.deadline_us = 90'000;
  p.asks.chains = {{"", 0, 1, 50'000}, {"", 0, 0, 20'000}};
  p.asks.clocks.push_back({"lens", 50});
  p.sources[0].clock = 1;
  return p;
}

TEST(Profile, WhatTheProgramAsksIsInItsApp) {
  const Profile p = of_two_rates();
  const auto again = parse_profile(to_json(p), "profile.json");
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, p);
  const auto app = to_app(p, Platform::builtin("small").value(), WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_FALSE(app->one_at_a_time);
  ASSERT_EQ(app->chains.size(), 3u);
  EXPECT_EQ(app->chains[0].deadline_us, 50'000);
  EXPECT_EQ(app->chains[1].deadline_us, 90'000) << "no deadline of its own";
  EXPECT_EQ(app->chains[2].name, "camera -> a");
  EXPECT_EQ(app->chains[2].deadline_us, 20'000);
  ASSERT_EQ(app->clocks.size(), 2u);
  EXPECT_EQ(app->clocks[1], (ClockSpec{"lens", 50}));
  EXPECT_EQ(app->sources[0].clock, 1);
  const auto read = parse_app(to_json(*app), "app.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, *app);
}

TEST(Profile, TheDeadlineOfTheWholeIsThatOfEachChain) {
  Profile p = of_two_rates();
  p.asks = {};
  p.asks.deadline_us = 90'000;
  p.sources[0] = {"camera", {100'000}};
  const auto app = to_app(p, Platform::builtin("small").value(), WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_EQ(app->deadline_us, 90'000);
  ASSERT_EQ(app->chains.size(), 2u);
  for (const ChainSpec& one : app->chains) EXPECT_EQ(one.deadline_us, 90'000) << one.name;
}

TEST(Profile, WhatNoPolicyCanHoldIsSaidBeforeItIsMeasured) {
  Profile p = of_two_rates();
  EXPECT_TRUE(can_be_planned(p));
  p.edges.emplace_back(1, 2);
  p.xnodes[2].sources = {1};
  EXPECT_FALSE(validate(p)) << "c has a predecessor";
  p = of_two_rates();
  p.xnodes[2].sources = {0, 1};
  const Status join = can_be_planned(p);
  ASSERT_FALSE(join);
  EXPECT_NE(join.error().what.find("joins sources 'camera'"), std::string::npos)
      << join.error().what;
  EXPECT_NE(join.error().hint.find("XModule::add_sampled_topic"), std::string::npos);
  p = of_two_rates();
  p.asks.chains.push_back({"", 1, 1, 1'000});
  const Status way = can_be_planned(p);
  ASSERT_FALSE(way);
  EXPECT_NE(way.error().what.find("does not hear of source 'lidar'"), std::string::npos)
      << way.error().what;
}

TEST(Profile, RefusesWhatIsAskedOfNothing) {
  const auto refused = [](auto&& change) {
    Profile p = of_two_rates();
    change(p);
    return !validate(p);
  };
  EXPECT_TRUE(refused([](Profile& p) { p.asks.chains[0].from = 2; }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.chains[0].to = 3; }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.chains[0].deadline_us.reset(); }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.chains[0].deadline_us = 0; }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.chains[1] = p.asks.chains[0]; }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.clocks[1].ppm = kMaxPpm + 1; }));
  EXPECT_TRUE(refused([](Profile& p) { p.asks.clocks[1].name = "main"; }));
  EXPECT_TRUE(refused([](Profile& p) { p.sources[0].clock = 2; }));
}

}  // namespace
}  // namespace xauto

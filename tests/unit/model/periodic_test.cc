// SPDX-License-Identifier: Apache-2.0
// Apps of version 2: their components, chains and hash. What their files may not say:
// tests/golden/errors/app-2.
#include "model/periodic.h"

#include <gtest/gtest.h>

#include "model/components.h"
#include "model/json.h"

#include "../golden_cases.h"

namespace xauto {
namespace {

AppSpec periodic_app() {
  return parse_app(test::slurp(test::golden() / "app-2.json"), "app-2.json").value();
}

/// One XNode per source, each a module and a component.
AppSpec islands(const std::vector<SourceSpec>& sources) {
  AppSpec app;
  app.version = 2;
  app.name = "islands";
  app.sources = sources;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const std::string name = "n" + std::to_string(i);
    app.xnodes.push_back({name, name, {{"cpu", 10}}, {static_cast<int>(i)}});
  }
  complete_modules(app);
  complete_chains(app);
  return app;
}

TEST(Components, OfTheGoldenApp) {
  const AppSpec app = periodic_app();
  const Components found = find_components(app).value();
  EXPECT_EQ(found.ticks_per_us, 3);
  EXPECT_EQ(found.of, (std::vector<int>{0, 0, 0, 1, 2}));
  const Component& fcd = found.components[0];
  EXPECT_EQ(fcd.xnodes, (std::vector<int>{0, 1, 2}));
  EXPECT_EQ(fcd.sources, (std::vector<int>{0, 1}));
  EXPECT_EQ(fcd.modules, (std::vector<int>{0}));
  EXPECT_EQ(fcd.period, (Period{100'000, 3}));
  EXPECT_EQ(fcd.period_ticks, 100'000);
  EXPECT_EQ(fcd.offset_us, 0) << "the least of 0 and 1000";
  EXPECT_EQ(fcd.activations, 3);
  EXPECT_EQ(found.components[2].activations, 5);
  ASSERT_EQ(found.domains.size(), 2u);
  EXPECT_EQ(found.domains[0].components, (std::vector<int>{0, 2}));
  EXPECT_EQ(found.domains[0].hyperperiod_ticks, 300'000);
  EXPECT_EQ(found.domains[0].jobs, 3 * 3 + 5);
  EXPECT_EQ(found.domains[1].clock, 1);
  EXPECT_EQ(found.components[1].domain, 1);
}

TEST(Components, OffsetIsTheLeastOfWhatItsXNodesHear) {
  AppSpec app = islands({{"a", {1000}, 700}, {"b", {1000}, 300}, {"c", {1000}, 100}});
  app.xnodes[1].module = app.xnodes[0].module;
  app.xnodes.push_back({"join", app.xnodes[0].module, {{"cpu", 1}}});
  app.edges = {{0, 3}, {1, 3}};
  const Components found = find_components(app).value();
  ASSERT_EQ(found.components.size(), 2u);
  EXPECT_EQ(found.components[0].offset_us, 300);
  EXPECT_EQ(found.components[1].offset_us, 100);
}

TEST(Components, HyperperiodThatDoesNotFitIsSaidAndDoesNotOverflow) {
  // Primes of microseconds: their product is beyond 64 bits.
  AppSpec app = islands({{"a", {999'999'937}}, {"b", {999'999'929}}, {"c", {999'999'893}}});
  ASSERT_TRUE(validate(app));
  Components found = find_components(app).value();
  EXPECT_FALSE(found.domains[0].hyperperiod_ticks);
  EXPECT_EQ(found.domains[0].jobs, 0);
  EXPECT_EQ(found.components[0].activations, 0);
  // Two of them fit.
  app = islands({{"a", {999'999'937}}, {"b", {999'999'929}}});
  found = find_components(app).value();
  EXPECT_EQ(found.domains[0].hyperperiod_ticks, 999'999'937ll * 999'999'929ll);
  EXPECT_EQ(found.components[0].activations, 999'999'929);
  // With ticks of a millionth they do not.
  app.sources.push_back({"fine", Period::of_rate("999999").value()});
  EXPECT_FALSE(find_components(app).value().domains[0].hyperperiod_ticks);
}

TEST(Components, JobsThatDoNotFitAreSaid) {
  // 2^59 ticks at a period of one tick, by 20 000 XNodes.
  AppSpec app = islands({{"long", {kMaxPeriodUs}}, {"short", {1}}});
  app.sources[0].period = {3'599'999'999, 1};
  app.sources.push_back({"other", {159'999'999, 1}});
  app.xnodes.push_back({"other", "other", {{"cpu", 1}}, {2}});
  for (int i = 0; i < 15'000; ++i) {
    app.xnodes.push_back({"s" + std::to_string(i), "n1", {{"cpu", 1}}});
    app.edges.emplace_back(1, static_cast<int>(app.xnodes.size()) - 1);
  }
  const Components found = find_components(app).value();
  ASSERT_TRUE(found.domains[0].hyperperiod_ticks);
  EXPECT_GT(found.components[1].activations, INT64_MAX / 20'000);
  EXPECT_EQ(found.domains[0].jobs, 0);
}

TEST(Periodic, ChainsAreFromEverySourceToEveryLastXNodeThatHearsOfIt) {
  AppSpec app = periodic_app();
  app.chains.clear();
  complete_chains(app);
  std::vector<std::string> names;
  for (const ChainSpec& chain : app.chains) names.push_back(chain.name);
  // "film" is heard by nobody. fcd is heard by la through mpc, and by mpc; what samples lead back
  // to is no way: nothing enters a component twice.
  EXPECT_EQ(names,
            (std::vector<std::string>{"camera -> fcd.post", "camera -> spur/größe", "camera -> mpc",
                                      "rear -> fcd.post", "rear -> spur/größe", "rear -> mpc",
                                      "lidar/größe -> spur/größe", "lidar/größe -> mpc",
                                      "tick -> spur/größe", "tick -> mpc"}));
  EXPECT_TRUE(validate(app));
}

TEST(Periodic, DefaultChainsHaveShortAndDifferentNames) {
  AppSpec app = islands({{std::string(200, 'a'), {1000}}, {"b", {1000}}});
  app.xnodes[0].name = std::string(200, 'n');
  app.chains.clear();
  complete_chains(app);
  ASSERT_EQ(app.chains.size(), 2u);
  EXPECT_EQ(app.chains[0].name, "chain 0");
  EXPECT_TRUE(validate(app));
}

/// Samples all round: a ring of components.
TEST(Periodic, RingsOfSamplesAreFine) {
  std::vector<SourceSpec> sources;
  for (int i = 0; i < 60; ++i) sources.push_back({"s" + std::to_string(i), {1000 + i}});
  AppSpec app = islands(sources);
  for (int i = 0; i < 60; ++i)
    for (int k = 1; k < 60; ++k) app.samples.emplace_back(i, (i + k) % 60);
  app.chains.clear();
  complete_chains(app);
  EXPECT_EQ(app.chains.size(), 3600u);
  EXPECT_TRUE(validate(app));
}

TEST(Periodic, SampleBackInsideAComponentIsFeedback) {
  AppSpec app = islands({{"a", {1000}}});
  for (int i = 1; i < 100; ++i) {
    app.xnodes.push_back({"n" + std::to_string(i), "n0", {{"cpu", 1}}});
    app.edges.emplace_back(i - 1, i);
  }
  app.chains = {{"all", 0, 99}};
  for (int i = 0; i < 100; ++i) app.samples.emplace_back(99, i);
  EXPECT_TRUE(validate(app));
  app.samples.emplace_back(3, 98);
  const Status status = validate(app);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().where, "/samples/100");
}

TEST(Periodic, HashChangesWithEveryThingThatAClaimDependsOn) {
  const AppSpec app = periodic_app();
  std::set<std::string> hashes = {app.hash()};
  const auto differs = [&](const char* what, const auto& change) {
    AppSpec other = app;
    change(other);
    EXPECT_TRUE(hashes.insert(other.hash()).second) << what;
  };
  differs("version", [](AppSpec& a) { a.version = 1; });
  differs("clock", [](AppSpec& a) { a.clocks[1].name = "l"; });
  differs("ppm", [](AppSpec& a) { ++a.clocks[1].ppm; });
  differs("clock of a source", [](AppSpec& a) { a.sources[0].clock = 1; });
  differs("period", [](AppSpec& a) { ++a.sources[0].period.num; });
  differs("rate", [](AppSpec& a) { ++a.sources[0].period.den; });
  differs("offset", [](AppSpec& a) { ++a.sources[0].offset_us; });
  differs("jitter", [](AppSpec& a) { ++a.sources[0].jitter_us; });
  differs("heard", [](AppSpec& a) { a.xnodes[0].sources = {0}; });
  differs("in flight", [](AppSpec& a) { ++a.modules[0].max_in_flight; });
  differs("optional", [](AppSpec& a) { a.modules[0].optional = true; });
  differs("variant", [](AppSpec& a) { a.xnodes[1].variants.clear(); });
  differs("quality", [](AppSpec& a) { ++a.xnodes[1].variants[0].quality_pct; });
  differs("wcet of a variant", [](AppSpec& a) { ++a.xnodes[1].variants[0].wcet_us["gpu"]; });
  differs("sample", [](AppSpec& a) { a.samples.pop_back(); });
  differs("chain", [](AppSpec& a) { a.chains.pop_back(); });
  differs("from", [](AppSpec& a) { a.chains[0].from = 1; });
  differs("deadline", [](AppSpec& a) { ++*a.chains[0].deadline_us; });
  differs("weight", [](AppSpec& a) { ++a.chains[0].weight; });
  differs("transfer", [](AppSpec& a) { ++a.transfers[0].transfer_us; });
  differs("type of a transfer", [](AppSpec& a) { a.transfers[0].to_type = "gpu"; });

  AppSpec same = app;
  std::swap(same.samples[0], same.samples[1]);
  std::swap(same.modules[0], same.modules[1]);
  std::swap(same.edges[0], same.edges[1]);
  for (TransferSpec& transfer : same.transfers) transfer.edge = 1;
  same.transfers.push_back({1, "cpu", "gpu", 0});
  same.clocks.push_back({"unused", 7});
  EXPECT_EQ(same.hash(), app.hash());
}

TEST(Periodic, WhatAFileLeavesOutIsFilledIn) {
  const AppSpec app =
      parse_app(R"({"schema":"xauto.app","version":2,"name":"a","edges":[],)"
                R"("sources":[{"name":"s","rate_hz":29.97,"clock":"ptp"}],)"
                R"("xnodes":[{"name":"x","module":"M","source":"s","wcet_us":{"cpu":1}}]})",
                "a.json")
          .value();
  EXPECT_EQ(app.clocks, (std::vector<ClockSpec>{{"main", 0}, {"ptp", 100}}));
  EXPECT_EQ(app.sources[0].period, (Period{100'000'000, 2997}));
  EXPECT_EQ(app.modules, (std::vector<ModuleSpec>{{"M", 1, false}}));
  EXPECT_EQ(app.chains, (std::vector<ChainSpec>{{"s -> x", 0, 0, {}, 1}}));
  const AppSpec again = parse_app(to_json(app), "a.json").value();
  EXPECT_EQ(again, app);
}

TEST(Periodic, UrgentReleasesAreRead) {
  AppSpec app = parse_app(test::slurp(test::golden() / "app-2.json"), "a").value();
  const std::string hash = app.hash();
  app.sources[0].urgent = {2000, 1'000'000};
  ASSERT_TRUE(validate(app)) << validate(app).error().to_string();
  EXPECT_NE(app.hash(), hash);
  EXPECT_EQ(parse_app(to_json(app), "a").value(), app);
  app.sources[0].urgent = {33'333, 33'334};  // 33333 1/3
  EXPECT_TRUE(validate(app));
  app.sources[0].urgent->every_us = 33'333;
  EXPECT_FALSE(validate(app));
}

// A join that two sources may make urgent would have two amounts.
TEST(Periodic, OneSourceOfAComponentMayBeUrgent) {
  AppSpec app = islands({{"a", {1000}}, {"b", {1000}}});
  app.xnodes.push_back({"join", "j", {{"cpu", 10}}});
  app.edges = {{0, 2}, {1, 2}};
  app.chains.clear();
  complete_modules(app);
  complete_chains(app);
  app.sources[0].urgent = {100, 5000};
  ASSERT_TRUE(validate(app)) << validate(app).error().to_string();
  app.sources[1].urgent = {100, 5000};
  const Status status = validate(app);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().where, "/sources/1/urgent");
}

TEST(KeyPolicy, SaysTheUrgentWorstCaseWhereTheSourceMayBe) {
  AppSpec app = islands({{"a", {1000}}});
  app.sources[0].urgent = {100, 5000};
  const Platform platform = Platform::builtin("small").value();
  KeyPolicy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {500}}};
  policy.chains = {{app.chains[0].name, 500, 10, false}};
  EXPECT_FALSE(validate(policy, app, platform));
  policy.chains[0].urgent_worst_case_us = 400;
  ASSERT_TRUE(validate(policy, app, platform));
  EXPECT_EQ(parse_key_policy(to_json(policy, app, platform), "p", app, platform).value(), policy);
  app.sources[0].urgent.reset();
  policy.app_hash = app.hash();
  EXPECT_FALSE(validate(policy, app, platform));
}

// In memory, version 1 could carry what its file has no place for.
TEST(Periodic, Version1HasNothingOfVersion2) {
  const AppSpec plain = parse_app(test::slurp(test::golden() / "app-sources.json"), "a").value();
  ASSERT_TRUE(validate(plain));
  const auto refused = [&](const auto& change) {
    AppSpec app = plain;
    change(app);
    return !validate(app).has_value();
  };
  EXPECT_TRUE(refused([](AppSpec& a) { a.sources[0].period = {100'000, 3}; }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.sources[0].jitter_us = 1; }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.clocks.push_back({"lidar", 1}); }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.modules.push_back({"FCD", 2}); }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.samples.emplace_back(2, 3); }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.chains.push_back({"c", 0, 2}); }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.transfers.push_back({0, "cpu", "gpu", 1}); }));
  EXPECT_TRUE(refused([](AppSpec& a) { a.version = 3; }));
}

TEST(Periodic, AppOfVersion1BecomesOneOfVersion2WhereItsPeriodsAllow) {
  AppSpec app = parse_app(test::slurp(test::golden() / "app-sources.json"), "a").value();
  const auto refused = as_version_2(app);
  ASSERT_FALSE(refused) << "an XNode hears of 33333 us and of 100000 us";
  EXPECT_EQ(refused.error().where, "/xnodes/3/source");
  app.xnodes[3].sources = {1};
  const auto periodic = as_version_2(app);
  ASSERT_TRUE(periodic) << periodic.error().to_string();
  EXPECT_EQ(periodic->version, 2);
  EXPECT_EQ(periodic->modules.size(), 2u);
  ASSERT_EQ(periodic->chains.size(), 2u);
  EXPECT_EQ(periodic->chains[0].deadline_us, app.deadline_us);
  EXPECT_EQ(parse_app(to_json(*periodic), "a").value(), *periodic);
  app.xnodes[3].sources.clear();
  EXPECT_FALSE(as_version_2(app)) << "nothing releases it";
}

// Nobody who plans one release takes it for one.
TEST(Periodic, LoadAppTakesVersion1Alone) {
  const std::string path = (test::golden() / "app-2.json").string();
  const auto refused = load_app(path);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, path + ": /version");
  EXPECT_TRUE(load_any_app(path));
  EXPECT_EQ(load_any_app((test::golden() / "app.json").string())->version, 1);
}

TEST(KeyPolicy, OfALongHyperperiodHasOneKeyPerXNode) {
  const AppSpec app = islands({{"a", {999'999'937}}, {"b", {999'999'929}}, {"c", {999'999'893}}});
  const Platform platform = Platform::builtin("small").value();
  KeyPolicy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  for (int i = 0; i < 3; ++i) policy.placements.push_back({0, {100}});
  for (const ChainSpec& chain : app.chains) policy.chains.push_back({chain.name, 100, 10, false});
  EXPECT_TRUE(validate(policy, app, platform));
  policy.placements[0].key_us = {100, 100};
  const Status status = validate(policy, app, platform);
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().what.find("beyond 64 bits"), std::string::npos);
}

// Keys of u and v that are never of one activation are not compared.
TEST(KeyPolicy, KeysOfOneActivationAreCompared) {
  AppSpec app = islands({{"fast", {1000}}, {"slow", {6000}}});
  app.xnodes.push_back({"next", "n0", {{"cpu", 10}}});
  app.edges = {{0, 2}};
  app.chains.clear();
  complete_chains(app);
  KeyPolicy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  // 2 and 6 keys: entry 0 of n0 is of the even activations.
  policy.placements = {{0, {100, 500}}, {1, {10}}, {2, {110, 510, 110, 510, 110, 510}}};
  for (const ChainSpec& chain : app.chains) policy.chains.push_back({chain.name, 600, 10, false});
  const Platform platform = Platform::builtin("small").value();
  const Status status = validate(policy, app, platform);
  EXPECT_TRUE(status) << status.error().to_string();
  policy.placements[2].key_us = {510, 110, 510, 110, 510, 110};
  EXPECT_FALSE(validate(policy, app, platform));
  // 2 and 3: every pair meets.
  policy.placements[2].key_us = {510, 510, 510};
  EXPECT_TRUE(validate(policy, app, platform));
  policy.placements[2].key_us = {510, 509, 510};
  EXPECT_FALSE(validate(policy, app, platform));
}

}  // namespace
}  // namespace xauto

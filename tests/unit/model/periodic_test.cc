// SPDX-License-Identifier: Apache-2.0
// Components, chains and hash of apps, with rates and one at a time. What their files may not say, too:
// tests/golden/errors/app.txt.
#include "model/periodic.h"

#include <gtest/gtest.h>

#include "model/components.h"
#include "model/json.h"

#include "../golden_cases.h"

namespace xauto {
namespace {

AppSpec periodic_app() {
  return parse_app(test::slurp(test::golden() / "app-rates.json"), "app-rates.json").value();
}

/// One XNode per source, each a module and a component.
AppSpec islands(const std::vector<SourceSpec>& sources) {
  AppSpec app;
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
  differs("one at a time", [](AppSpec& a) { a.one_at_a_time = true; });
  differs("deadline of all", [](AppSpec& a) { a.deadline_us = 1; });
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
      parse_app(R"({"schema":"xauto.app","version":3,"name":"a","edges":[],)"
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
  AppSpec app = parse_app(test::slurp(test::golden() / "app-rates.json"), "a").value();
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

TEST(Periodic, AModuleMarksWhatItHeardOfForThoseBehindIt) {
  AppSpec app;
  app.name = "a";
  app.sources = {{"camera", {10'000}}, {"lidar", {10'000}}};
  app.xnodes = {{"see", "M", {{"cpu", 1}}, {0}},
                {"think", "M", {{"cpu", 1}}},
                {"act", "N", {{"cpu", 1}}},
                {"map", "L", {{"cpu", 1}}, {1}}};
  app.edges = {{0, 1}, {1, 2}};
  complete_modules(app);
  complete_chains(app);
  const auto refusal = [&](const char* module) {
    app.sources[0].urgent = {100, 10'000, module};
    const Status status = validate(app);
    return status ? std::string() : status.error().what;
  };
  EXPECT_EQ(refusal(""), "");
  const std::string by_driver = app.hash();
  EXPECT_EQ(refusal("M"), "");
  EXPECT_NE(app.hash(), by_driver) << "a claim depends on it";
  EXPECT_EQ(parse_app(to_json(app), "app.json").value().sources, app.sources);
  EXPECT_EQ(refusal("N"),
            "module 'N' has nobody who hears of it by edges: nothing would be urgent");
  EXPECT_EQ(refusal("L"), "module 'L' does not hear of source 'camera' by edges");
  EXPECT_EQ(refusal("none"), "module 'none' does not hear of source 'camera' by edges");
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

TEST(Policy, SaysTheUrgentWorstCaseWhereTheSourceMayBe) {
  AppSpec app = islands({{"a", {1000}}});
  app.sources[0].urgent = {100, 5000};
  const Platform platform = Platform::builtin("small").value();
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {500}}};
  policy.chains = {{app.chains[0].name, 500, 10, false}};
  EXPECT_FALSE(validate(policy, app, platform));
  policy.chains[0].urgent_worst_case_us = 400;
  ASSERT_TRUE(validate(policy, app, platform));
  EXPECT_EQ(parse_policy(to_json(policy, app, platform), "p", app, platform).value(), policy);
  app.sources[0].urgent.reset();
  policy.app_hash = app.hash();
  EXPECT_FALSE(validate(policy, app, platform));
}

// ---- sources without a rate ---------------------------------------------------------------------

/// a (camera) -> b; c (lidar), without a chain.
std::string one_at_a_time(const std::string& more = "",
                          const std::string& sources = R"({"name":"camera"},{"name":"lidar"})") {
  return R"({"schema":"xauto.app","version":3,"name":"once","sources":[)" + sources +
         R"(],"xnodes":[{"name":"a","module":"A","source":"camera","wcet_us":{"cpu":10}},)"
         R"({"name":"b","module":"B","wcet_us":{"cpu":10}},)"
         R"({"name":"c","module":"C","source":"lidar","wcet_us":{"cpu":10}}],)"
         R"("edges":[["a","b"]])" +
         more + "}";
}
/// Where and what is refused, and the hint; "": nothing is.
std::string refusal_of_app(const std::string& text) {
  const auto app = parse_app(text, "a.json");
  return app ? std::string() : app.error().to_string();
}

TEST(OneAtATime, IsAnAppOfWhichNoSourceHasARate) {
  const auto app = parse_app(one_at_a_time(), "a.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_TRUE(app->one_at_a_time);
  EXPECT_EQ(app->rates(), 1u);
  for (const SourceSpec& source : app->sources) EXPECT_EQ(source.period, kNoRate);
  const std::string text = to_json(*app);
  EXPECT_EQ(text.find("period_us"), std::string::npos);
  EXPECT_EQ(parse_app(text, "again").value(), *app);
  AppSpec hourly = *app;  // that is something else
  hourly.one_at_a_time = false;
  EXPECT_NE(hourly.hash(), app->hash());
}

TEST(OneAtATime, AllSourcesHaveARateOrNoneHas) {
  const std::string hint = "hint: give every source a rate, or none";
  for (const auto& [sources, where] : std::vector<std::pair<std::string, std::string>>{
           {R"({"name":"camera"},{"name":"lidar","rate_hz":10})", "/sources/1: has a rate"},
           {R"({"name":"camera","period_us":10},{"name":"lidar"})", "/sources/1: has neither"},
           {R"({"name":"camera"},{"name":"lidar"},{"name":"radar","period_us":10})",
            "/sources/2: has a rate"}}) {
    const std::string said = refusal_of_app(one_at_a_time("", sources));
    EXPECT_NE(said.find("a.json: " + where), std::string::npos) << said;
    EXPECT_NE(said.find(hint), std::string::npos) << said;
  }
}

TEST(OneAtATime, WhatNeedsARateIsRefused) {
  const std::string hint = "hint: give every source a rate";
  const auto refused = [&](const std::string& text, const std::string& where) {
    const std::string said = refusal_of_app(text);
    EXPECT_EQ(said.find("a.json: " + where + ": "), 0u) << said;
    EXPECT_NE(said.find(hint), std::string::npos) << said;
  };
  for (const char* rest : {R"("offset_us":5)", R"("jitter_us":1)", R"("clock":"lens")",
                           R"("urgent":{"by_us":1,"every_us":3600000000})"})
    refused(one_at_a_time("", R"({"name":"camera"},{"name":"lidar",)" + std::string(rest) + "}"),
            "/sources/1");
  EXPECT_EQ(
      refusal_of_app(one_at_a_time(
          "", R"({"name":"camera","offset_us":0,"jitter_us":0,"clock":"main"},{"name":"lidar"})")),
      "")
      << "that says nothing";
  refused(one_at_a_time(R"(,"samples":[["b","c"]])"), "/samples/0");
  refused(one_at_a_time(R"(,"modules":[{"name":"B","max_in_flight":2}])"),
          "/modules/1/max_in_flight");
  AppSpec app = parse_app(one_at_a_time(), "a.json").value();
  app.sources[1].period = {10};  // only in memory
  ASSERT_FALSE(validate(app));
  EXPECT_EQ(validate(app).error().where, "/sources/1");
}

// kNoRate is the hour of Period's limit: a release that takes longer would meet the next one.
TEST(OneAtATime, AReleaseTakesAnHourAtMost) {
  AppSpec app = parse_app(one_at_a_time(), "a.json").value();
  const Platform platform{"one", {{"cpu0", "cpu"}}};
  app.xnodes[0].wcet_us["cpu"] = kMaxPeriodUs - 20;
  EXPECT_TRUE(validate_on(app, platform)) << validate_on(app, platform).error().to_string();
  ++app.xnodes[0].wcet_us["cpu"];
  const Status over = validate_on(app, platform);
  ASSERT_FALSE(over);
  EXPECT_NE(over.error().what.find("a release takes up to 3600000000 us"), std::string::npos)
      << over.error().what;
  app.one_at_a_time = false;
  EXPECT_TRUE(validate_on(app, platform)) << "with rates one release may overlap the next";
}

// ---- chains of "*" ------------------------------------------------------------------------------

/// camera -> a -> b; camera and rear -> c -> b, d.
std::string forked(const std::string& chains) {
  return R"({"schema":"xauto.app","version":3,"name":"fork",)"
         R"("sources":[{"name":"camera","rate_hz":10},{"name":"rear","rate_hz":10}],)"
         R"("xnodes":[{"name":"a","module":"A","source":"camera","wcet_us":{"cpu":10}},)"
         R"({"name":"b","module":"B","wcet_us":{"cpu":10}},)"
         R"({"name":"c","module":"C","source":["camera","rear"],"wcet_us":{"cpu":10}},)"
         R"({"name":"d","module":"D","wcet_us":{"cpu":10}}],)"
         R"("edges":[["a","b"],["c","b"],["c","d"]],"deadline_us":900,"chains":)" +
         chains + "}";
}
/// "from to deadline weight" of each chain, as it stands.
std::vector<std::string> chains_of(const std::string& text) {
  const auto app = parse_app(text, "a.json");
  EXPECT_TRUE(app) << app.error().to_string();
  std::vector<std::string> all;
  if (!app) return all;
  for (const ChainSpec& chain : app->chains)
    all.push_back(app->sources[static_cast<std::size_t>(chain.from)].name + " " +
                  app->xnodes[static_cast<std::size_t>(chain.to)].name + " " +
                  std::to_string(chain.deadline_us.value_or(0)) + " " +
                  std::to_string(chain.weight));
  EXPECT_EQ(parse_app(to_json(*app), "again").value(), *app);
  return all;
}
using Lines = std::vector<std::string>;

TEST(EveryChain, IsOfEverySourceOrOfEveryLastXNodeOrOfBoth) {
  const Lines all = {"camera b 500 2", "camera d 500 2", "rear b 500 2", "rear d 500 2"};
  EXPECT_EQ(chains_of(forked(R"([{"from":"*","to":"*","deadline_us":500,"weight":2}])")), all);
  EXPECT_EQ(chains_of(forked(R"([{"from":"*","to":"d","deadline_us":500}])")),
            (Lines{"camera d 500 1", "rear d 500 1"}));
  EXPECT_EQ(chains_of(forked(R"([{"from":"rear","to":"*"}])")),
            (Lines{"rear b 900 1", "rear d 900 1"}))
      << "the deadline of all where it has none";
}

TEST(EveryChain, IsOfThoseThatNoOtherEntrySays) {
  EXPECT_EQ(
      chains_of(forked(R"([{"from":"*","to":"*","deadline_us":500},)"
                       R"({"name":"side","from":"camera","to":"d","deadline_us":70},)"
                       R"({"name":"inner","from":"rear","to":"c"}])")),
      (Lines{"camera d 70 1", "rear c 900 1", "camera b 500 1", "rear b 500 1", "rear d 500 1"}))
      << "named ones stand before, wherever the file has them";
  EXPECT_EQ(chains_of(forked(R"([{"from":"rear","to":"*","deadline_us":40},)"
                             R"({"from":"*","to":"*","deadline_us":500}])")),
            (Lines{"rear b 40 1", "rear d 40 1", "camera b 500 1", "camera d 500 1"}))
      << "of two of them the first";
}

TEST(EveryChain, IsRefusedWithItsPlaceInTheFile) {
  EXPECT_EQ(refusal_of_app(forked(R"([{"name":"n","from":"rear","to":"d"},{"from":"*","to":"c"}])"))
                .find("a.json: /chains/1: stands for no chain of the app"),
            0u)
      << "c is not a last one";
  EXPECT_EQ(refusal_of_app(forked(R"([{"from":"*","to":"*","name":"all"}])"))
                .find("a.json: /chains/0/name"),
            0u)
      << "no option is passed over in silence";
  EXPECT_EQ(refusal_of_app(forked(R"([{"from":"*","to":"b"},{"name":"n","from":"rear","to":"a"}])"))
                .find("a.json: /chains/1: XNode 'a' does not hear of source 'rear'"),
            0u);
  EXPECT_EQ(refusal_of_app(forked(R"([{"from":"radar","to":"*"}])")).find("a.json: /chains/0/from"),
            0u);
  EXPECT_EQ(refusal_of_app(forked(R"([{"from":"*","to":"nobody"}])")).find("a.json: /chains/0/to"),
            0u);
  std::string text = forked(R"([{"from":"*","to":"*"}])");  // not the chains are at fault
  text.replace(text.find("10}", text.find("rear")), 2, "20");
  EXPECT_EQ(refusal_of_app(text).find("a.json: /xnodes/2/source"), 0u) << refusal_of_app(text);
}

// What is written of a chain from a source of that name would be read as every source's.
TEST(EveryChain, NobodyIsCalledAsEveryEndIs) {
  std::string source = forked(R"([{"name":"n","from":"camera","to":"d"}])"), xnode = source;
  source.replace(source.find(R"("rear")"), 6, R"("*")");
  EXPECT_EQ(refusal_of_app(source).find("a.json: /sources/1/name"), std::string::npos)
      << "'c' hears of 'rear', which is gone: that is said first";
  AppSpec app = parse_app(xnode, "a.json").value();
  app.sources[1].name = kEveryEnd;
  ASSERT_FALSE(validate(app));
  EXPECT_EQ(validate(app).error().where, "/sources/1/name");
  app.sources[1].name = "rear";
  app.xnodes[3].name = kEveryEnd;
  ASSERT_FALSE(validate(app));
  EXPECT_EQ(validate(app).error().where, "/xnodes/3/name");
}

// ---- policies of priorities ---------------------------------------------------------------------

struct ByPriority {
  AppSpec app = parse_app(one_at_a_time(), "a.json").value();
  Platform platform{"two", {{"cpu0", "cpu"}, {"cpu1", "cpu"}}};
  Policy policy;
  ByPriority() {
    policy.app = app.name;
    policy.app_hash = app.hash();
    policy.platform = platform.name;
    policy.method = "test";
    policy.certified = false;
    for (int i = 0; i < 3; ++i) {
      policy.placements.push_back({0, {}});
      policy.placements.back().priority = i;
    }
  }
  [[nodiscard]] std::string error() const {
    const Status status = validate(policy, app, platform);
    return status ? std::string() : status.error().to_string();
  }
};

TEST(Policy, PrioritiesAreReadAsTheyWereWritten) {
  ByPriority p;
  p.policy.order = {{1, 2}};
  ASSERT_EQ(p.error(), "");
  EXPECT_TRUE(p.policy.by_priority());
  EXPECT_EQ(parse_policy(to_json(p.policy, p.app, p.platform), "p", p.app, p.platform).value(),
            p.policy);
  EXPECT_EQ(by_priorities(assignment_of(p.policy), p.app), [&] {
    Policy same = p.policy;
    same.method = assignment_of(p.policy).method;
    return same;
  }());
  // The same with rates: priorities say nothing of when.
  p.app.one_at_a_time = false;
  for (SourceSpec& source : p.app.sources) source.period = {1000};
  p.policy.app_hash = p.app.hash();
  EXPECT_EQ(p.error(), "");
}

TEST(Policy, PrioritiesStandAloneAndClaimNothing) {
  const auto error = [](const auto& spoil) {
    ByPriority p;
    spoil(p.policy);
    return p.error();
  };
  const std::string one = "give each XNode a priority, or each keys";
  for (const std::size_t i : {0u, 2u}) {
    const std::string mixed = error([&](Policy& p) {
      p.placements[i].priority.reset();
      p.placements[i].key_us = {100};
    });
    EXPECT_NE(mixed.find(one), std::string::npos) << mixed;
    EXPECT_EQ(mixed.find("/xnodes/"), 0u) << mixed;
    EXPECT_NE(error([&](Policy& p) { p.placements[i].key_us = {100}; }).find(one),
              std::string::npos);
    EXPECT_NE(error([&](Policy& p) { p.placements[i].hold_us = {100}; }).find(one),
              std::string::npos);
  }
  EXPECT_EQ(error([](Policy& p) {
              p.placements[1].start_us = {0};
              p.placements[1].finish_us = {10};
            }).find("/xnodes/1/start_us"),
            0u);
  EXPECT_EQ(error([](Policy& p) { p.placements[2].priority = 0; }),
            "/xnodes/2/priority: XNode 'c' has priority 0 on cpu0, as 'a' has\n"
            "  hint: priorities are unique per XPU instance");
  EXPECT_EQ(error([](Policy& p) {
              p.placements[2].priority = 0;
              p.placements[2].xpu = 1;
            }),
            "");
  EXPECT_EQ(error([](Policy& p) {
              p.placements[2].priority = kMaxTimeUs + 1;
            }).find("/xnodes/2/priority"),
            0u);
  const std::string claims = error([](Policy& p) { p.certified = true; });
  EXPECT_EQ(claims.find("/certified: priorities are not certified"), 0u) << claims;
  EXPECT_EQ(error([](Policy& p) {
              p.chains = {{"camera -> b", 1, 1, true}};
            }).find("/certified"),
            0u);
}

TEST(Policy, OrderHoldsBesidePriorities) {
  const auto error = [](std::vector<std::pair<int, int>> order, int xpu_of_c = 0) {
    ByPriority p;
    p.policy.order = std::move(order);
    p.policy.placements[2].xpu = xpu_of_c;
    return p.error();
  };
  EXPECT_EQ(error({{2, 0}, {2, 1}}), "") << "all of an app without rates is released together";
  EXPECT_EQ(error({{1, 0}}).find("/order: the order and the app's edges form a cycle"), 0u);
  EXPECT_EQ(error({{0, 2}, {2, 0}}).find("/order: the order"), 0u);
  EXPECT_EQ(error({{0, 2}}, 1).find("/order/0: 'a' before 'c': they are on different XPUs"), 0u);
  EXPECT_EQ(error({{0, 3}}).find("/order/0"), 0u);
}

// Whoever reads it is not told that a claim is missing, but that there can be none.
TEST(Policy, PrioritiesInAFileSayThatTheyAreNotCertified) {
  const ByPriority p;
  std::string text = to_json(p.policy, p.app, p.platform);
  const std::string line = "  \"certified\": false,\n";
  text.replace(text.find(line), line.size(), "");
  const auto refused = parse_policy(text, "p.json", p.app, p.platform);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().to_string(),
            "p.json: /certified: priorities are not certified: nothing can be claimed of them\n"
            "  hint: say \"certified\": false, and leave \"chains\" out");
}

// As a hint it says where XNodes are, and no more: a policy of keys is what comes of it.
TEST(Policy, AsAHintPrioritiesSayWhereXNodesAre) {
  ByPriority p;
  p.policy.placements[1].xpu = 1;
  p.policy.order = {{0, 2}};
  const auto hint =
      parse_key_hint(to_json(p.policy, p.app, p.platform), "p.json", p.app, p.platform);
  ASSERT_TRUE(hint) << hint.error().to_string();
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(hint->placements[i].xpu, p.policy.placements[i].xpu);
    EXPECT_TRUE(hint->placements[i].key_us.empty());
    EXPECT_FALSE(hint->placements[i].priority);
  }
  EXPECT_EQ(hint->order, p.policy.order);
}

TEST(Policy, OfALongHyperperiodHasOneKeyPerXNode) {
  const AppSpec app = islands({{"a", {999'999'937}}, {"b", {999'999'929}}, {"c", {999'999'893}}});
  const Platform platform = Platform::builtin("small").value();
  Policy policy;
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
TEST(Policy, KeysOfOneActivationAreCompared) {
  AppSpec app = islands({{"fast", {1000}}, {"slow", {6000}}});
  app.xnodes.push_back({"next", "n0", {{"cpu", 10}}});
  app.edges = {{0, 2}};
  app.chains.clear();
  complete_chains(app);
  Policy policy;
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

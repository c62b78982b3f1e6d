// SPDX-License-Identifier: Apache-2.0
// Latency and age of chains, by times that the test makes up.
#include "account/routes.h"

#include <optional>

#include <gtest/gtest.h>

#include "processes/board.h"

namespace xauto::runtime {
namespace {

/// lidar, camera -> Fuse -> fused -> Plan (sink);  camera -> Log (sink)
Graph make_graph(bool single_rate) {
  Graph graph;
  graph.single_rate = single_rate;
  const auto topic = [&](const char* name, int source, int module) {
    Graph::Topic t;
    t.spec.name = name;
    t.source = source;
    t.module = module;
    graph.topics.push_back(t);
  };
  const auto module = [&](const char* name, std::vector<int> inputs, std::vector<int> outputs,
                          bool sink) {
    const int index = static_cast<int>(graph.modules.size());
    graph.nodes.push_back({name, index});
    Graph::Module m;
    m.name = name;
    m.nodes = {index};
    m.inputs = std::move(inputs);
    m.outputs = std::move(outputs);
    m.sink = sink;
    graph.modules.push_back(std::move(m));
  };
  topic("lidar", 0, -1);
  topic("camera", 1, -1);
  graph.topic_of_source = {0, 1};
  topic("fused", -1, 0);
  graph.topics[0].subscribers = {{0, 0}};
  graph.topics[1].subscribers = {{0, 1}, {2, 0}};
  graph.topics[2].subscribers = {{1, 0}};
  module("Fuse", {0, 1}, {2}, false);
  module("Plan", {2}, {}, true);
  module("Log", {1}, {}, true);
  return graph;
}

AppSpec with_deadline(std::int64_t us) {
  AppSpec app;
  app.deadline_us = us;
  return app;
}

TEST(Routes, WithoutADeploymentEverySensorToEverySinkThatHearsOfIt) {
  const auto routes = Routes::make(make_graph(true), {}, {}, with_deadline(50));
  ASSERT_TRUE(routes);
  std::vector<std::string> names;
  for (const ChainAccount& r : routes->report({0, 0, 0})) {
    names.push_back(r.name);
    EXPECT_EQ(r.deadline_us, 50);
  }
  EXPECT_EQ(names, (std::vector<std::string>{"lidar -> Plan", "camera -> Plan", "camera -> Log"}));
  EXPECT_FALSE(routes->end_at(0));
  EXPECT_TRUE(routes->end_at(1));
}

TEST(Routes, CountsLatenciesAgesAndLostReleasesAgainstTheirLimits) {
  Deployment d;
  d.chains = {{"x", "lidar", "Fuse", 30, 120}};
  auto routes = Routes::make(make_graph(true), {}, d, {});
  ASSERT_TRUE(routes);
  routes->published(0, 1'000'000, nullptr, 1'020'000);  // 20 us
  routes->published(0, 1'100'000, nullptr, 1'131'000);  // 31: late; the first became 131 old
  routes->published(0, 1'200'000, nullptr, 1'210'000);  // 10; the second became 110 old
  routes->published(1, 1, nullptr, 2);                  // of no chain
  const ChainAccount r = routes->report({4, 0, 0}).at(0);
  EXPECT_EQ(r.latency_us.exact(), (std::vector<std::int64_t>{20, 31, 10}));
  EXPECT_EQ(r.age_us.exact(), (std::vector<std::int64_t>{131, 110}));
  EXPECT_EQ(r.lost, 4u);
  EXPECT_EQ(r.deadline_misses, 1u + 4u);
  EXPECT_EQ(r.age_misses, 1u);
}

TEST(Routes, SeveralRatesHaveALatencyPerSensor) {
  auto routes = Routes::make(make_graph(false), {}, {}, {});
  ASSERT_TRUE(routes);
  const detail::Origins both = {1'000'000, 1'050'000}, camera = {0, 1'100'000};
  routes->published(1, 1'000'000, &both, 1'060'000);
  routes->published(1, 1'100'000, &camera, 1'130'000);
  const auto reports = routes->report({0, 0, 0});
  EXPECT_EQ(reports[0].latency_us.exact(), (std::vector<std::int64_t>{60}));
  EXPECT_EQ(reports[1].latency_us.exact(), (std::vector<std::int64_t>{10, 30}));
  EXPECT_EQ(reports[1].age_us.exact(), (std::vector<std::int64_t>{80}));
}

TEST(Routes, RefusesAChainThatLeadsNowhere) {
  Deployment d;
  d.chains = {{"x", "fused", "Plan", {}, {}}};
  EXPECT_EQ(Routes::make(make_graph(true), {}, d, {}).error().what,
            "'fused' is not the topic of a source");
  d.chains = {{"x", "lidar", "Log", {}, {}}};
  EXPECT_EQ(Routes::make(make_graph(true), {}, d, {}).error().to_string(),
            "chain 'x': nothing of topic 'lidar' reaches XModule 'Log'");
}

/// Period 100 ns of lidar; the chain ends at Fuse. Each release counts until the first result that
/// knows it or a newer one.
TEST(Routes, OfVersion2EachReleaseHasAReaction) {
  Graph graph = make_graph(false);
  graph.sources = {{"lidar", {100}}, {"camera", {100}}};
  Grid grid;
  grid.periodic = true;
  grid.sources = {{{100}, 0, 0}, {{100}, 0, 0}};
  grid.urgent_source = {0, -1, -1};  // of the lidar, where the chain ends
  AppSpec app;
  app.sources = graph.sources;
  app.xnodes = {{"Fuse", "Fuse", {}}};
  app.chains = {{"c", 0, 0, 250}};
  auto routes = Routes::make(graph, grid, {}, app);
  ASSERT_TRUE(routes);
  const auto result = [&](std::int64_t origin_us, std::int64_t now_us, bool urgent = false) {
    detail::Origins origins{};
    origins[0] = origin_us * 1000;
    routes->published(0, 1, &origins, now_us * 1000, urgent);
  };
  for (const std::int64_t us : {1000, 1100, 1200, 1300, 1400}) routes->released(0, us * 1000);
  result(1000, 1120);        // the first that is known: 120
  result(1000, 1150);        // knows nothing new
  result(1300, 1390, true);  // 1100, 1200 and 1300, which waited 290, 190 and 90
  const ChainAccount r = routes->report({0, 0, 0}).at(0);
  EXPECT_EQ(r.latency_us.exact(), (std::vector<std::int64_t>{120, 90, 190, 290}));
  EXPECT_EQ(r.deadline_misses, 1u) << "of those, one was later than 250";
  EXPECT_EQ(r.urgent_us.exact(), std::vector<std::int64_t>{90}) << "the release that was urgent";
}

/// Of an app of rates: sources and XNodes every 100 us, and Log samples what Fuse makes.
Result<Routes> log_samples(std::vector<ChainSpec> chains, bool single_rate = false) {
  Graph graph = make_graph(single_rate);
  graph.sources = {{"lidar", {100}}, {"camera", {100}}};
  graph.modules[0].component = graph.modules[1].component = 0;
  graph.modules[2].component = 1;
  Grid grid;
  grid.periodic = true;
  grid.sources = {{{100}, 0, 0}, {{100}, 0, 0}};
  grid.urgent_source = {-1, -1, -1};
  AppSpec app;
  app.sources = graph.sources;
  app.xnodes = {{"Fuse", "Fuse", {}}, {"Plan", "Plan", {}}, {"Log", "Log", {}}};
  app.chains = std::move(chains);
  return Routes::make(graph, grid, {}, app);
}

/// A run that gave up at 2000 us, where the lidar was released last at 1900, and the camera so long.
TEST(Routes, WhatHasNoResultIsLostAndMissedOnceItsDeadlineHasPassed) {
  auto routes =
      log_samples({{"to Fuse", 0, 0, 250}, {"to Plan", 0, 1, 250}, {"sampled", 0, 2, 250}});
  ASSERT_TRUE(routes);
  for (std::int64_t us = 1000; us <= 1900; us += 100) routes->released(0, us * 1000);
  detail::Origins origins{};
  origins[0] = 1'600'000;
  routes->published(0, 1, &origins, 1'650'000);
  routes->published(2, 1, &origins, 1'650'000);
  const Routes::Unended left{2'000'000, {3, 10, 2}};
  const auto reports = routes->report({0, 0, 1}, &left, {1'900'000, 1'900'000});
  EXPECT_EQ(reports.at(0).lost, 3u);
  EXPECT_EQ(reports.at(0).deadline_misses, 5u)
      << "1000 to 1300 have a result, a late one; 1700 has none; 1800 and 1900 still had time";
  EXPECT_EQ(reports.at(1).lost, 10u);
  EXPECT_EQ(reports.at(1).deadline_misses, 8u) << "1000 to 1700: there was no result at all";
  EXPECT_EQ(reports.at(2).lost, 0u) << "its reader was released last at 1900: all had time";
  EXPECT_EQ(reports.at(2).deadline_misses, 0u) << "at 1900, when its reader was released last";
}

TEST(Routes, InAnAppOfOneRateWhatDidNotEndIsMissed) {
  auto routes = Routes::make(make_graph(true), {}, {}, with_deadline(50));
  ASSERT_TRUE(routes);
  Routes::Unended left{2'000'000, {0, 4, 0}};
  const std::vector<std::int64_t> newest_ns{1'900'000, 1'900'000};
  EXPECT_EQ(routes->report({0, 1, 0}, &left, newest_ns).at(0).deadline_misses, 5u);
  left.at_ns = 1'940'000;  // nobody knows how many of them still had time
  EXPECT_EQ(routes->report({0, 1, 0}, &left, newest_ns).at(0).deadline_misses, 1u);
}

/// An app of two rates by hand: the lidar's period is 100 us, and "c" leads to Fuse, of its own component.
struct ByKeys {
  explicit ByKeys(std::int64_t period_us = 100) {
    Graph graph = make_graph(false);
    graph.sources = {{"lidar", {period_us}}, {"camera", {30}}};
    graph.modules[0].component = 0;
    graph.modules[1].component = 1;  // Plan samples what it hears of
    graph.modules[2].component = 2;
    Grid grid;
    grid.periodic = true;
    grid.sources = {{{period_us}, 0, 0}, {{30}, 0, 0}};
    grid.urgent_source = {-1, -1, -1};
    AppSpec app;
    app.sources = graph.sources;
    app.xnodes = {{"Fuse", "Fuse", {}}, {"Plan", "Plan", {}}};
    app.chains = {{"c", 0, 0, 250}, {"through", 0, 1, 250}};
    auto made = Routes::make(graph, grid, {}, app);
    EXPECT_TRUE(made);
    routes.emplace(std::move(*made));
  }
  void released(std::int64_t us, std::size_t source = 0) { routes->released(source, us * 1000); }
  void result(std::int64_t origin_us, std::int64_t at_us, int node = 0) {
    detail::Origins origins{};
    origins[0] = origin_us * 1000;
    routes->published(node, 1, &origins, at_us * 1000);
  }
  [[nodiscard]] ChainAccount report(std::size_t chain = 0) const {
    return routes->report({0, 0, 0}).at(chain);
  }
  std::optional<Routes> routes;
};

using Times = std::vector<std::int64_t>;

/// A sensor need not keep its period: a result counts for the releases that there were.
TEST(Routes, EveryReleaseCountsHoweverNearToTheOneBefore) {
  ByKeys fast;
  for (std::int64_t us = 1000; us < 1200; us += 20) {
    fast.released(us);
    fast.result(us, us + 7);
  }
  EXPECT_EQ(fast.report().latency_us.exact(), Times(10, 7));
  // One result for three of them.
  for (const std::int64_t us : {2000, 2001, 2003}) fast.released(us);
  fast.result(2003, 2010);
  const Times all = fast.report().latency_us.exact();
  EXPECT_EQ(Times(all.end() - 3, all.end()), (Times{7, 9, 10}));
}

TEST(Routes, WhatWasNeverReleasedHasNoLatency) {
  ByKeys slow;
  for (const std::int64_t us : {1000, 1350, 2700}) {  // 100 is stated
    slow.released(us);
    slow.result(us, us + 7);
  }
  EXPECT_EQ(slow.report().latency_us.exact(), Times(3, 7));
}

/// After a message that came too soon the next one may be nominally before it.
TEST(Routes, ReleasesCountInTheirOrderNotByTheirTimes) {
  ByKeys app;
  for (const std::int64_t us : {1000, 1110, 1105}) app.released(us);
  app.result(1000, 1010);
  app.result(1110, 1120);
  app.result(1105, 1130);
  app.result(1105, 1999);  // nothing new
  EXPECT_EQ(app.report().latency_us.exact(), (Times{10, 10, 25}));
}

TEST(Routes, ReleasesThatNothingComesOfAreForgottenButTheNewest) {
  ByKeys app;
  for (std::int64_t k = 0; k < 5000; ++k) app.released(1000 + k);
  app.result(1000 + 4999, 6000);
  EXPECT_EQ(app.report().latency_us.count(), 1000u);
  EXPECT_EQ(app.report().latency_us.max(), 6000 - (1000 + 4000));
}

/// In lockstep 100 ms may lie between two releases, and nothing is late by that.
TEST(Routes, InLockstepOnlyTheNewestReleaseIsTimed) {
  ByKeys app;
  app.routes->in_lockstep();
  const auto board = Board::local({1, 3, 0, 3});
  app.routes->show_on(*board);
  std::int64_t at = 1'000'000;
  for (int k = 0; k < 5; ++k) {
    app.released(at);
    app.result(at, at + 5);
    const std::int64_t lidar = at;
    for (int of_camera = 0; of_camera < 3; ++of_camera) {
      at += 100'000;
      app.released(at, 1);
      app.result(lidar, at + 3, 1);  // Plan, by the camera, has read what came of the lidar
    }
    at += 100'000;
  }
  EXPECT_EQ(app.report(0).latency_us.exact(), Times(5, 5));
  EXPECT_EQ(app.report(0).not_measured, 0u);
  EXPECT_EQ(app.report(1).latency_us.count(), 0u);
  EXPECT_EQ(app.report(1).deadline_misses, 0u);
  EXPECT_EQ(app.report(1).not_measured, 4u) << "the first through a sample counts nowhere";
  for (const std::size_t chain : {0u, 1u}) {
    EXPECT_EQ(app.report(chain).age_us.count(), 0u);
    EXPECT_EQ(board->flow(chain + 1).last_origin_ns.load(), 0) << "`top` shows no age";
  }
}

/// In an app of one rate a release drains before the next, and an age is how long that took.
TEST(Routes, InLockstepAnAppOfOneRateHasAges) {
  auto routes = Routes::make(make_graph(true), {}, {}, {});
  ASSERT_TRUE(routes);
  routes->in_lockstep();
  for (const std::int64_t us : {1000, 1010, 1020}) {
    for (const std::size_t source : {0u, 1u}) routes->released(source, us * 1000);
    routes->published(1, us * 1000, nullptr, (us + 8) * 1000);
  }
  const ChainAccount r = routes->report({0, 0, 0}).at(0);
  EXPECT_EQ(r.latency_us.exact(), Times(3, 8));
  EXPECT_EQ(r.age_us.exact(), Times(2, 18));
}

/// docs/keys.md, "Chains": release k comes through a sample with the first activation n of the
/// reader that begins after its result is there, which may be less than k. At the beginning it is not there.
TEST(Routes, TheFirstThatComesThroughSamplesIsNotCounted) {
  auto routes = log_samples({{"through", 0, 2, 250}, {"inside", 0, 1, 250}});
  ASSERT_TRUE(routes);
  for (std::int64_t n = 0; n < 6; ++n) routes->released(0, (1000 + n * 100) * 1000);
  for (std::int64_t n = 0; n < 5; ++n)
    for (const int node : {1, 2}) {
      // Log, activation n: begins at 100 n + 280, and reads release n + 1. Plan has release n.
      detail::Origins origins{};
      origins[0] = (1000 + (node == 2 ? n + 1 : n) * 100) * 1000;
      routes->published(node, 1, &origins, (1000 + n * 100 + (node == 2 ? 300 : 60)) * 1000);
    }
  const auto reports = routes->report({0, 0, 0});
  EXPECT_EQ(reports.at(0).latency_us.exact(), (std::vector<std::int64_t>{200, 200, 200, 200}));
  EXPECT_EQ(reports.at(1).latency_us.exact(), (std::vector<std::int64_t>{60, 60, 60, 60, 60}));
}

/// Every release of a source of one rate ends once, as a result or as lost: what was dropped between two results the
/// later one knows, and what came after the last one nobody does.
TEST(Routes, ResultsAndLostAreTheReleases) {
  auto routes = log_samples({{"to Fuse", 0, 0, 250}});
  ASSERT_TRUE(routes);
  for (std::int64_t us = 1000; us < 2000; us += 100) routes->released(0, us * 1000);
  for (const std::int64_t us : {1100, 1600}) {
    detail::Origins origins{};
    origins[0] = us * 1000;
    routes->published(0, 1, &origins, (us + 50) * 1000);
  }
  const ChainAccount chain = routes->report({8, 0, 0}, nullptr, {1'900'000, 9'000'000}).at(0);
  EXPECT_EQ(chain.results(), 7u);
  EXPECT_EQ(chain.lost, 3u) << "1700 to 1900: the camera went on";
  EXPECT_EQ(chain.deadline_misses, 5u)
      << "1200 and 1300, whose result came at 1650; and 1700 to 1900";
}

/// A chain that a table does not have loses nothing, however long it is gone; what it lost before stays lost.
TEST(Routes, WhatIsOffIsNotLost) {
  auto routes = log_samples({{"to Fuse", 0, 0, 250}});
  ASSERT_TRUE(routes);
  routes->released(0, 1'000'000);
  detail::Origins origins{};
  origins[0] = 1'000'000;
  routes->published(0, 1, &origins, 1'050'000);
  routes->released(0, 1'100'000);  // dropped
  routes->have(1'200'000, {0});
  for (std::int64_t us = 1'200; us < 301'200; us += 100) routes->released(0, us * 1000);
  const ChainAccount chain = routes->report({9, 0, 0}, nullptr, {301'100'000, 0}).at(0);
  EXPECT_EQ(chain.lost, 1u);
  EXPECT_EQ(chain.deadline_misses, 1u);
}

/// In lockstep a release is lost if a result of the one after it is the first to know it, or if none does. A source with
/// an offset is not: its release is the newest of its own.
TEST(Routes, InLockstepWhatIsLostIsCountedToo) {
  auto routes = log_samples({{"lidar", 0, 0, 250}, {"camera", 1, 0, 250}}, true);
  ASSERT_TRUE(routes);
  routes->in_lockstep();
  for (int k = 0; k < 5; ++k) {
    const std::int64_t lidar_ns = 1'000'000 + k * 100'000, camera_ns = lidar_ns + 30'000;
    routes->released(0, lidar_ns);
    routes->released(1, camera_ns);
    if (k == 1 || k == 4) continue;  // the release has no result
    detail::Origins origins{};
    origins[0] = lidar_ns;
    origins[1] = camera_ns;
    routes->published(0, 1, &origins, camera_ns + 20'000);
  }
  const auto chains = routes->report({2, 0, 0}, nullptr, {1'400'000, 1'430'000});
  EXPECT_EQ(chains.at(1).results(), 3u);
  EXPECT_EQ(chains.at(0).results() + chains.at(0).not_measured, 3u) << "the camera came after it";
  for (const ChainAccount& chain : chains) {
    EXPECT_EQ(chain.lost, 2u) << chain.name;
    EXPECT_EQ(chain.deadline_misses, 2u) << chain.name;
  }
}

/// By tables a release is held against what is claimed of it, by when it was released.
TEST(Routes, EachReleaseIsHeldAgainstItsOwnClaim) {
  Deployment d;
  d.chains = {{"x", "lidar", "Fuse", {}, {}}};
  auto routes = Routes::make(make_graph(true), {}, d, {});
  ASSERT_TRUE(routes);
  routes->claims_may_change();
  const auto over = [&] {
    routes->judge();
    return routes->report({0, 0, 0}).at(0).over_claim;
  };
  const auto result = [&](std::int64_t origin_us, std::int64_t takes_us) {
    routes->published(0, origin_us * 1000, nullptr, (origin_us + takes_us) * 1000);
  };
  result(100, 999);
  EXPECT_EQ(over(), 0u) << "nothing is claimed yet";
  routes->claim(0, {20});
  routes->claim(1'000'000, {50});  // a change, and when it has settled
  routes->claim(2'000'000, {10});
  result(900, 20);
  result(1000, 50);
  result(2000, 10);
  EXPECT_EQ(over(), 0u);
  result(2100, 11);
  EXPECT_EQ(over(), 1u);
  result(999, 21);  // a result of an older release that comes late
  EXPECT_EQ(over(), 2u);
  routes->claim(1'500'000, {0});  // the next change, of which nothing is claimed
  routes->claim(3'000'000, {30});
  result(1499, 51);
  EXPECT_EQ(over(), 3u);
  result(2200, 999);
  result(3000, 30);
  EXPECT_EQ(over(), 3u);
  result(3100, 31);
  EXPECT_EQ(over(), 4u);
  const auto worst = [&] {
    const ChainAccount r = routes->report({0, 0, 0}).at(0);
    return std::pair(r.over_us, r.over_claimed_us);
  };
  EXPECT_EQ(worst(), std::pair(std::int64_t{11}, std::int64_t{10})) << "the first of equal ones";
  routes->claim(4'000'000, {100}, 2);  // an emulator's own part
  result(4000, 102);
  EXPECT_EQ(over(), 4u);
  result(4100, 103);
  EXPECT_EQ(over(), 5u);
  EXPECT_EQ(worst(), std::pair(std::int64_t{103}, std::int64_t{100}))
      << "what is claimed, without it";
  // The job that was too long is known to be only now, and with it the change.
  result(5000, 199);
  routes->claim(4'900'000, {200});
  EXPECT_EQ(over(), 5u);
  result(5000, 201);
  EXPECT_EQ(over(), 6u);
}

/// Of each change the result that was nearest to its claim; of all of them one on the board.
TEST(Routes, WhatMetAChangeIsToldBesideItsClaim) {
  Deployment d;
  d.chains = {{"x", "lidar", "Fuse", {}, {}}, {"y", "lidar", "Fuse", {}, {}}};
  auto routes = Routes::make(make_graph(true), {}, d, {});
  ASSERT_TRUE(routes);
  const auto board = Board::local({.modules = 3, .flows = 3, .scenarios = 3});
  routes->show_on(*board);
  const auto result = [&](std::int64_t origin_us, std::int64_t takes_us) {
    routes->published(0, origin_us * 1000, nullptr, (origin_us + takes_us) * 1000);
  };
  routes->claim(0, {20, 30});
  result(500, 19);
  routes->judge();
  EXPECT_TRUE(routes->met().empty()) << "it met no change";
  EXPECT_FALSE(board->header().spanned.read());
  routes->claim(1'000'000, {50, 40}, 2, MetChange{7, 0, 2});
  routes->claim(2'000'000, {20, 30});
  for (const std::int64_t us : {10, 30, 20}) result(1000 + us, us);
  result(2500, 20);  // nearer to its claim, but it met no change
  routes->claim(3'000'000, {0, 100}, 2, MetChange{9, 2, 1});  // nothing is claimed of x
  routes->claim(4'000'000, {20, 30});
  result(3100, 60);
  routes->judge();
  const auto met = routes->met();
  ASSERT_EQ(met.size(), 2u);
  EXPECT_EQ(std::tuple(met[0].change, met[0].chain, met[0].us, met[0].claimed_us),
            std::tuple(7u, 1u, std::int64_t{30}, std::int64_t{40}));
  EXPECT_EQ(std::tuple(met[1].change, met[1].chain, met[1].us, met[1].claimed_us),
            std::tuple(9u, 1u, std::int64_t{60}, std::int64_t{100}));
  const auto worst = board->header().spanned.read();
  ASSERT_TRUE(worst);
  EXPECT_EQ(std::tuple(worst->from, worst->to, worst->flow, worst->us, worst->worst_case_us),
            std::tuple(0u, 2u, 2u, std::int64_t{30}, std::int64_t{40}));
  result(1900, 35);  // a late one of the first change
  routes->judge();
  EXPECT_EQ(routes->met().size(), 2u);
  EXPECT_EQ(routes->met()[0].us, 35);
}

/// A table without the chain: nobody waits for a result of its releases, nor for those that had none yet.
TEST(Routes, WhatIsOffIsNeitherLateNorOld) {
  Deployment d;
  d.chains = {{"x", "lidar", "Fuse", 50, 100}};
  auto routes = Routes::make(make_graph(true), {}, d, {});
  ASSERT_TRUE(routes);
  const auto result = [&](std::int64_t origin_us, std::int64_t at_us) {
    return routes->published(0, origin_us * 1000, nullptr, at_us * 1000);
  };
  routes->have(0, {1});
  EXPECT_FALSE(result(900, 920));
  routes->have(1'000'000, {0});
  EXPECT_EQ(result(940, 1010), 110) << "of a table that has it: late, and the one before is old";
  routes->have(3'000'000, {1});
  EXPECT_FALSE(result(980, 3010)) << "it waited while the chain was off";
  EXPECT_FALSE(result(2900, 3020)) << "had no such table";
  EXPECT_FALSE(result(3010, 3040));
  EXPECT_EQ(result(3100, 3160), 150) << "late, and what it replaces is old";
  const ChainAccount report = routes->report({0, 0, 0}).at(0);
  EXPECT_EQ(report.latency_us.exact(), (std::vector<std::int64_t>{20, 70, 30, 60}));
  EXPECT_EQ(report.deadline_misses, 2u);
}

TEST(Routes, WhoLooksSeesWhatIsOff) {
  Deployment d;
  d.chains = {{"x", "lidar", "Fuse", 50, 100}};
  auto routes = Routes::make(make_graph(true), {}, d, {});
  ASSERT_TRUE(routes);
  const auto board = Board::local({1, 3, 0, 2});
  routes->show_on(*board);
  const FlowLine& line = board->flow(1);
  routes->have(0, {1});
  EXPECT_EQ(line.gone.load(), 0u);
  EXPECT_EQ(line.gone_or_back_ns.load(), 0);
  routes->have(1'000, {0});
  routes->have(2'000, {0});
  EXPECT_EQ(line.gone.load(), 1u);
  EXPECT_EQ(line.gone_or_back_ns.load(), 1'000);
  routes->have(3'000, {1});
  EXPECT_EQ(line.gone.load(), 0u);
  EXPECT_EQ(line.gone_or_back_ns.load(), 3'000);
}

}  // namespace
}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Latency and age of chains, by times that the test makes up.
#include "runtime/routes.h"

#include <gtest/gtest.h>

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
  topic("lidar", 0, -1);
  topic("camera", 1, -1);
  topic("fused", -1, 0);
  graph.topics[0].subscribers = {{0, 0}};
  graph.topics[1].subscribers = {{0, 1}, {2, 0}};
  graph.topics[2].subscribers = {{1, 0}};
  graph.modules.push_back({"Fuse", nullptr, {}, {0, 1}, {2}, false});
  graph.modules.push_back({"Plan", nullptr, {}, {2}, {}, true});
  graph.modules.push_back({"Log", nullptr, {}, {1}, {}, true});
  return graph;
}

TEST(Routes, WithoutADeploymentEverySensorToEverySinkThatHearsOfIt) {
  const auto routes = Routes::make(make_graph(true), {}, 50);
  ASSERT_TRUE(routes);
  std::vector<std::string> names;
  for (const RouteReport& r : routes->report({0, 0, 0})) {
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
  auto routes = Routes::make(make_graph(true), d, {});
  ASSERT_TRUE(routes);
  routes->published(0, 1'000'000, nullptr, 1'020'000);  // 20 us
  routes->published(0, 1'100'000, nullptr, 1'131'000);  // 31: late; the first became 131 old
  routes->published(0, 1'200'000, nullptr, 1'210'000);  // 10; the second became 110 old
  routes->published(1, 1, nullptr, 2);                  // of no chain
  const RouteReport r = routes->report({4, 0, 0}).at(0);
  EXPECT_EQ(r.latency_us.exact(), (std::vector<std::int64_t>{20, 31, 10}));
  EXPECT_EQ(r.age_us.exact(), (std::vector<std::int64_t>{131, 110}));
  EXPECT_EQ(r.lost, 4u);
  EXPECT_EQ(r.deadline_misses, 1u + 4u);
  EXPECT_EQ(r.age_misses, 1u);
}

TEST(Routes, SeveralRatesHaveALatencyPerSensor) {
  auto routes = Routes::make(make_graph(false), {}, {});
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
  EXPECT_EQ(Routes::make(make_graph(true), d, {}).error().what,
            "'fused' is not the topic of a source");
  d.chains = {{"x", "lidar", "Log", {}, {}}};
  EXPECT_EQ(Routes::make(make_graph(true), d, {}).error().to_string(),
            "chain 'x': nothing of topic 'lidar' reaches XModule 'Log'");
}

}  // namespace
}  // namespace xauto::runtime

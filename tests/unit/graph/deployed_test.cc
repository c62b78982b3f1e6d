// SPDX-License-Identifier: Apache-2.0
#include "graph/deployed.h"

#include <chrono>

#include <gtest/gtest.h>

#include "graph/graph.h"

namespace xauto {
namespace {

using namespace std::chrono_literals;

/// A source, a module "lanes" that reads it, samples "speed" and publishes "lines", one that reads
/// "lines"; "clock" fires by the clock and publishes "speed".
class Deployed : public ::testing::Test {
 protected:
  Deployed() {
    app.name = "drive";
    app.sources.push_back({*detail::topic_spec(Topic<int>("image")), Period{10'000},
                           [](std::uint64_t, detail::MessageMemory*) { return nullptr; }});
    app.sources.push_back({*detail::topic_spec(Topic<int>("rear")), Period{10'000},
                           [](std::uint64_t, detail::MessageMemory*) { return nullptr; }});
    app.sources.push_back({*detail::topic_spec(Topic<double>("rain")), Period{10'000},
                           [](std::uint64_t, detail::MessageMemory*) { return nullptr; }});
    auto lanes = add("lanes");
    detail::add_input(*lanes, detail::topic_spec(Topic<int>("image")));
    detail::add_sample(*lanes, detail::topic_spec(Topic<int>("speed")), {});
    detail::add_output(*lanes, detail::topic_spec(Topic<int>("lines")), {});
    auto steer = add("steer");
    detail::add_input(*steer, detail::topic_spec(Topic<int>("lines")));
    auto clock = add("clock");
    detail::set_timer(*clock, 5ms);
    detail::add_output(*clock, detail::topic_spec(Topic<int>("speed")), {});
    detail::complete(app);
  }
  std::shared_ptr<detail::XModuleSpec> add(const std::string& name) {
    auto module = detail::make_xmodule(name, [] { return std::make_shared<int>(); });
    auto xnode = detail::make_xnode(name + ".work");
    detail::add_impl(*xnode, XPU::CPU, {});
    detail::add_node(*module, xnode);
    app.modules.push_back(module);
    return module;
  }
  std::string refusal() {
    const auto made = detail::deployed(app, deployment);
    if (!made) return made.error().to_string();
    const auto graph = runtime::Graph::build(*made);
    return graph ? "" : graph.error().what;
  }

  detail::AppSpecErased app;
  Deployment deployment;
};

TEST_F(Deployed, WithoutNamesEverythingStays) {
  const auto made = detail::deployed(app, {});
  ASSERT_TRUE(made);
  EXPECT_EQ(made->modules, app.modules);
  EXPECT_EQ(made->sources.size(), 4u);
}

TEST_F(Deployed, AModuleRunsUnderSeveralNames) {
  deployment.app = "drive";
  deployment.instances = {{"left", "lanes"}, {"right", "lanes"}, {"slow", "clock"}};
  deployment.modules["right"].remap = {{"image", "rear"}, {"lines", "lines"}};
  deployment.modules["slow"].remap = {{"speed", "speed"}};
  const auto made = detail::deployed(app, deployment);
  ASSERT_TRUE(made) << made.error().to_string();
  const auto graph = runtime::Graph::build(*made);
  ASSERT_TRUE(graph) << graph.error().to_string();
  std::vector<std::string> modules, xnodes, topics, sources;
  for (const auto& m : graph->modules) modules.push_back(m.name);
  for (const auto& n : graph->nodes) xnodes.push_back(n.name);
  for (const auto& s : graph->sources) sources.push_back(s.name);
  EXPECT_EQ(modules, (std::vector<std::string>{"left", "right", "steer", "slow"}));
  EXPECT_EQ(xnodes, (std::vector<std::string>{"left/lanes.work", "right/lanes.work", "steer.work",
                                              "slow/clock.work"}));
  EXPECT_EQ(sources, (std::vector<std::string>{"image", "rear", "rain", "slow/every"}));
  const auto topic = [&](int t) { return graph->topics[static_cast<std::size_t>(t)].spec.name; };
  EXPECT_EQ(topic(graph->modules[0].inputs[0]), "image");
  EXPECT_EQ(topic(graph->modules[0].outputs[0]), "left/lines");
  EXPECT_EQ(topic(graph->modules[0].samples[0]), "speed");
  EXPECT_EQ(topic(graph->modules[1].inputs[0]), "rear");
  EXPECT_EQ(topic(graph->modules[1].outputs[0]), "lines");
  EXPECT_EQ(graph->modules[1].spec->inputs[0].called, "image") << "as an exec asks";
  EXPECT_EQ(app.modules[0]->name, "lanes") << "the program's own is as it was";
  EXPECT_EQ(app.modules[0]->inputs[0].name, "image");
}

TEST_F(Deployed, WhatTheNamesAmountToIsJudgedAsInAnyApp) {
  deployment.instances = {{"left", "lanes"}};
  EXPECT_NE(refusal().find("topic 'lines' has no publisher, but XModule 'steer' reads it"),
            std::string::npos);
  deployment.modules["left"].remap = {{"image", "rain"}, {"lines", "lines"}};
  EXPECT_NE(refusal().find("topic 'rain' has two types: double (a source) and int (XModule 'left'"),
            std::string::npos)
      << refusal();
  deployment.modules["left"].remap = {{"image", "nowhere"}, {"lines", "lines"}};
  EXPECT_NE(refusal().find("topic 'nowhere' has no publisher"), std::string::npos);
  deployment.instances["right"] = "lanes";
  deployment.modules["left"].remap = {{"lines", "lines"}};
  deployment.modules["right"].remap = {{"lines", "lines"}};
  EXPECT_NE(refusal().find("topic 'lines' has two publishers: XModule 'left' and XModule 'right'"),
            std::string::npos);
  deployment.modules.clear();
  deployment.instances = {{"steer", "lanes"}};
  EXPECT_NE(refusal().find("two XModules are called 'steer'"), std::string::npos);
}

TEST_F(Deployed, NamesThatTheProgramLacksAreRefused) {
  deployment.app = "drive";
  deployment.instances = {{"left", "lane"}};
  EXPECT_EQ(refusal(),
            "deployment.json: instance 'left' is of XModule 'lane', which is not in the "
            "program\n  hint: the program has lanes, steer, clock");
  deployment.instances.clear();
  deployment.modules["left"].remap = {{"image", "rear"}};
  EXPECT_EQ(refusal(),
            "deployment.json: XModule 'left' is not in the program\n"
            "  hint: the program has lanes, steer, clock");
  deployment.modules.clear();
  deployment.modules["lanes"].remap = {{"imgae", "rear"}};
  EXPECT_EQ(refusal(),
            "deployment.json: XModule 'lanes' has no topic 'imgae' to remap\n"
            "  hint: its topics are image, lines, speed");
  deployment.modules.clear();
  deployment.modules["clock"].remap = {{"clock/every", "image"}};
  EXPECT_NE(refusal().find("has no topic 'clock/every' to remap"), std::string::npos);
}

TEST_F(Deployed, DeadlinesFollowInstancesAndRemappedTopics) {
  app.deadlines.push_back({*detail::topic_spec(Topic<int>("image")),
                           *detail::topic_spec(Topic<int>("lines")), nullptr, 7});
  app.deadlines.push_back(
      {*detail::topic_spec(Topic<int>("image")), std::nullopt, app.modules[1], 9});
  deployment.instances = {{"left", "lanes"}, {"right", "lanes"}};
  deployment.modules["left"].remap = {{"lines", "lines"}};
  deployment.modules["right"].remap = {{"image", "rear"}, {"lines", "rear_lines"}};
  const auto made = detail::deployed(app, deployment);
  ASSERT_TRUE(made);
  const auto graph = runtime::Graph::build(*made);
  ASSERT_TRUE(graph) << graph.error().what;
  std::vector<std::pair<std::string, std::int64_t>> ends;
  for (const ChainSpec& c : graph->asks.chains)
    ends.emplace_back(graph->nodes[static_cast<std::size_t>(c.to)].name, *c.deadline_us);
  using Ends = decltype(ends);
  EXPECT_EQ(ends, (Ends{{"left/lanes.work", 7}, {"right/lanes.work", 7}, {"steer.work", 9}}));
  EXPECT_EQ(graph->sources[static_cast<std::size_t>(graph->asks.chains[1].from)].name, "rear");
}

}  // namespace
}  // namespace xauto

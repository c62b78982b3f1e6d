// SPDX-License-Identifier: Apache-2.0
// Which modules count their activations together, and through which samples a source is known.
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "graph/graph.h"

namespace xauto::runtime {
namespace {

class Components : public ::testing::Test {
 protected:
  void source(const std::string& name, int period_ms) {
    detail::SourceSpec spec;
    spec.topic = *detail::topic_spec(Topic<int>(name));
    spec.period = {period_ms * std::int64_t{1000}};
    spec.make = [](std::uint64_t, detail::MessageMemory*) { return nullptr; };
    app_.sources.push_back(spec);
  }
  /// It publishes the topic of its name.
  void module(const std::string& name, const std::vector<std::string>& inputs,
              const std::vector<std::string>& samples = {}) {
    auto spec = std::make_shared<detail::XModuleSpec>();
    spec->name = name;
    auto node = detail::make_xnode(name + ".1");
    detail::add_impl(*node, XPU::CPU, {});
    spec->nodes.push_back(node);
    for (const std::string& t : inputs) spec->inputs.push_back(*detail::topic_spec(Topic<int>(t)));
    for (const std::string& t : samples)
      spec->samples.push_back({*detail::topic_spec(Topic<int>(t)), 0});
    spec->outputs.push_back({*detail::topic_spec(Topic<int>(name)), {}});
    app_.modules.push_back(spec);
  }
  Graph graph() {
    auto made = Graph::build(app_);
    EXPECT_TRUE(made) << made.error().to_string();
    return *made;
  }
  detail::AppSpecErased app_;
};

TEST_F(Components, OfOnePeriodAreNumberedBesideThoseThatAreNot) {
  source("fast", 10);
  source("also", 10);
  source("slow", 30);
  module("A", {"fast", "also"});
  module("B", {"A"});
  module("C", {"slow"}, {"B"});
  module("D", {"slow"});
  module("E", {"D", "fast"});
  const Graph g = graph();
  EXPECT_FALSE(g.single_rate);
  EXPECT_EQ(g.components, 3);
  EXPECT_EQ(g.modules[0].component, g.modules[1].component);
  EXPECT_NE(g.modules[2].component, g.modules[3].component) << "they only hear the same source";
  EXPECT_EQ(g.modules[3].component, g.modules[4].component);
  EXPECT_TRUE(g.modules[0].numbered && g.modules[1].numbered && g.modules[2].numbered);
  EXPECT_FALSE(g.modules[3].numbered || g.modules[4].numbered) << "10 ms joined with 30 ms";
  EXPECT_EQ(g.samples, (std::vector<std::pair<int, int>>{{1, 2}}));
  EXPECT_TRUE(g.modules[1].sink) << "who samples is not waited for";
  Graph matched = g;
  matched.match_by_origin(1);
  EXPECT_FALSE(matched.modules[0].numbered || matched.modules[1].numbered);
  EXPECT_TRUE(matched.modules[2].numbered);
}

/// a -> A ⇢ B ⇢ C ⇢ A, each with a source of its own.
TEST_F(Components, WhatComesRoundIsNoOriginOfItsOwnSource) {
  source("a", 10);
  source("b", 20);
  source("c", 30);
  module("A", {"a"}, {"C", "A"});
  module("B", {"b"}, {"A"});
  module("C", {"c"}, {"B", "c2"});
  source("c2", 40);
  const Graph g = graph();
  const auto bits = [&](int m, std::size_t s) {
    return g.modules[static_cast<std::size_t>(m)].sample_origins[s];
  };
  constexpr std::uint32_t a = 1, b = 2, c = 4, c2 = 8;
  EXPECT_EQ(bits(1, 0), a | c | c2) << "A tells B of a, and of what C told it; not of b";
  EXPECT_EQ(bits(2, 0), a | b);
  EXPECT_EQ(bits(0, 0), b | c | c2);
  EXPECT_EQ(bits(0, 1), 0u) << "its own result";
  EXPECT_EQ(bits(2, 1), c2) << "a source that is sampled itself";
}

/// a -> A ⇢ B ⇢ C, and A ⇢ C: C hears of a on two ways.
TEST_F(Components, AReleaseIsFollowedOnTheLongerWayToo) {
  source("a", 10);
  source("b", 20);
  source("c", 30);
  module("A", {"a"});
  module("B", {"b"}, {"A"});
  module("C", {"c"}, {"A", "B"});
  const Graph g = graph();
  EXPECT_EQ(g.modules[2].sample_origins, (std::vector<std::uint32_t>{1, 1 | 2}));
}

}  // namespace
}  // namespace xauto::runtime

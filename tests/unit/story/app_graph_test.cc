// SPDX-License-Identifier: Apache-2.0
// Against files that a person has looked at (tests/golden/graph.*). That an XML reader of its own
// finds each XNode and each arrow: tests/integration/graph_test.py.
#include "story/app_graph.h"

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <set>
#include <sstream>

#include <gtest/gtest.h>

#include "model/json.h"

#include "../golden_cases.h"
#include "count.h"

namespace xauto::story {
namespace {

using test::count;
using test::golden;
using test::slurp;

void expect_golden(const std::string& name, const std::string& text) {
  if (std::getenv("XAUTO_UPDATE_GOLDEN") != nullptr)
    std::ofstream(golden() / name, std::ios::binary) << text;
  EXPECT_EQ(text, slurp(golden() / name)) << name;
}

TEST(AppGraph, IsAsItWas) {
  const auto app = parse_app(slurp(golden() / "app-rates.json"), "app-rates.json");
  ASSERT_TRUE(app) << app.error().to_string();
  const auto platform = parse_platform(slurp(golden() / "platform.json"), "platform.json");
  ASSERT_TRUE(platform) << platform.error().to_string();
  const GraphPlaces places{&*platform, {2, 2, 0, 1, 0}};
  expect_golden("graph.dot", graph_dot(*app, places));
  expect_golden("graph.svg", graph_svg(*app, places));
}

/// A cluster and a band for each host, and X at what crosses.
TEST(AppGraph, HostsAndWhatCrosses) {
  AppSpec app;
  app.name = "pair";
  app.sources = {{"camera", {30'000}}};
  app.xnodes = {{"see", "SEE", {{"cpu", 1'000}}, {0}},
                {"know", "KNOW", {{"cpu", 1'000}}},
                {"act", "ACT", {{"cpu", 1'000}}, {0}}};
  app.edges = {{0, 1}};
  app.samples = {{1, 2}};
  Platform platform;
  platform.name = "two";
  platform.hosts = {{"front", 0}, {"re\"ar", 0}};
  platform.xpus = {{"cpu0", "cpu"}, {"cpu1", "cpu"}};
  platform.xpus[1].host = 1;
  const GraphPlaces places{&platform, {0, 1, 0}, {{0, 1, 1'700}, {1, 0, 900}}};
  const std::string dot = graph_dot(app, places), svg = graph_svg(app, places);
  EXPECT_EQ(count(dot, "subgraph cluster_host"), 2u);
  EXPECT_NE(dot.find("label=\"host re\\\"ar\""), std::string::npos) << dot;
  EXPECT_NE(
      dot.find(
          "x0 -> x1 [color=\"#0072B2\", fontcolor=\"#0072B2\", penwidth=2, label=\"X 1.7 ms\"];"),
      std::string::npos)
      << dot;
  EXPECT_NE(dot.find("label=\"sampled, X 0.9 ms\""), std::string::npos) << dot;
  EXPECT_NE(svg.find(">host front, 33.333 Hz<"), std::string::npos) << svg;
  EXPECT_NE(svg.find(">host re&quot;ar, 33.333 Hz<"), std::string::npos) << svg;
  EXPECT_EQ(count(svg, "class=\"line cross\""), 1u);
  EXPECT_NE(svg.find(">X 1.7 ms<"), std::string::npos) << svg;
  EXPECT_NE(svg.find(">samples know (X 0.9 ms)<"), std::string::npos) << svg;
}

AppSpec odd() {
  AppSpec app;
  app.name = "a\"b<c>&d\\N\n";
  app.sources = {{"s&lt;\t", {10'000}}};
  app.xnodes = {{"x\"]; y [", "m\\", {{"cpu", 1'000}}, {0}},
                {std::string(200, 'w') + "ß", "n", {{"<gpu>", 2'000}}}};
  app.edges = {{0, 1}};
  return app;
}

TEST(AppGraph, NamesAreText) {
  const std::string dot = graph_dot(odd(), {});
  EXPECT_EQ(dot.substr(0, dot.find(" {")), "digraph \"a\\\"b<c>&amp;d\\\\N\xEF\xBF\xBD\"");
  EXPECT_NE(dot.find("[label=\"x\\\"]; y [\\ncpu 1 ms\"]"), std::string::npos) << dot;
  EXPECT_NE(dot.find("label=\"m\\\\\";"), std::string::npos) << dot;
  EXPECT_NE(dot.find("s&amp;lt;\xEF\xBF\xBD"), std::string::npos) << dot;
  const std::string svg = graph_svg(odd(), {});
  EXPECT_NE(svg.find("a&quot;b&lt;c&gt;&amp;d\\N\xEF\xBF\xBD"), std::string::npos) << svg;
  EXPECT_EQ(svg.find('\t'), std::string::npos);
  EXPECT_NE(svg.find(">" + std::string(21, 'w') + "…<"), std::string::npos) << svg;
  EXPECT_NE(svg.find("s&amp;lt;"), std::string::npos);
}

TEST(AppGraph, SourcesWithoutARateReleaseOneAtATime) {
  const auto app = parse_app(slurp(golden() / "app.json"), "app.json");
  ASSERT_TRUE(app) << app.error().to_string();
  const std::string svg = graph_svg(*app, {});
  EXPECT_NE(svg.find("one at a time"), std::string::npos);
  EXPECT_EQ(svg.find(" Hz"), std::string::npos);
  EXPECT_EQ(count(svg, "class=\"line\""), app->edges.size() + app->sources.size());
}

/// Cells of one picture never lie on each other.
TEST(AppGraph, NothingIsDrawnOverSomethingElse) {
  AppSpec app;
  app.name = "wide";
  app.sources = {{"s", {10'000}}, {"t", {10'000}}};
  for (int i = 0; i < 60; ++i) {
    app.xnodes.push_back({"x" + std::to_string(i), "m" + std::to_string(i % 7), {{"cpu", 1'000}}});
    if (i < 8) app.xnodes.back().sources = {i % 2};
    for (int u = i % 5; u < i && i >= 8; u += 9) app.edges.emplace_back(u, i);
  }
  const std::string svg = graph_svg(app, {});
  std::set<std::string> places;
  std::size_t nodes = 0;
  const std::string rect = "<rect x=\"", node = "class=\"node none\"";
  for (std::size_t from = svg.find(rect); from != std::string::npos;
       from = svg.find(rect, from + 1)) {
    const std::string tag = svg.substr(from, svg.find('>', from) - from);
    if (tag.find(node) == std::string::npos) continue;
    ++nodes;
    places.insert(tag.substr(0, tag.find(" width")));
  }
  EXPECT_EQ(nodes, 62u);
  EXPECT_EQ(places.size(), nodes);
}

/// A stretch of a path "M x y H x V y ..." that sampling draws, against every node.
TEST(AppGraph, WhatIsSampledIsSeen) {
  const auto app = load_app(std::string(XAUTO_SOURCE_DIR) + "/examples/driving/rates.json");
  ASSERT_TRUE(app) << app.error().to_string();
  ASSERT_FALSE(app->samples.empty());
  const std::string svg = graph_svg(*app, {});
  struct Box {
    int x, y, right, bottom;
  };
  std::vector<Box> nodes;
  for (std::size_t at = svg.find("<rect "); at != std::string::npos;
       at = svg.find("<rect ", at + 1)) {
    int x = 0, y = 0, width = 0, height = 0;
    const std::string tag = svg.substr(at, svg.find('>', at) - at);
    if (tag.find("class=\"node") == std::string::npos) continue;
    ASSERT_EQ(std::sscanf(tag.c_str(), R"(<rect x="%d" y="%d" width="%d" height="%d")", &x, &y,
                          &width, &height),
              4);
    nodes.push_back({x, y, x + width, y + height});
  }
  EXPECT_EQ(nodes.size(), app->xnodes.size() + app->sources.size());
  std::size_t lines = 0;
  for (std::size_t at = svg.find("<path d=\"M"); at != std::string::npos;
       at = svg.find("<path d=\"M", at + 1)) {
    const std::string tag = svg.substr(at, svg.find('>', at) - at);
    if (tag.find("sample") == std::string::npos) continue;
    ++lines;
    std::istringstream path(tag.substr(10, tag.find('"', 10) - 10));
    int x = 0, y = 0, to = 0;
    path >> x >> y;
    for (char along = 0; path >> along >> to;) {
      const Box line = along == 'H' ? Box{std::min(x, to), y, std::max(x, to), y}
                                    : Box{x, std::min(y, to), x, std::max(y, to)};
      for (const Box& n : nodes)
        EXPECT_FALSE(line.x < n.right && line.right > n.x && line.y < n.bottom && line.bottom > n.y)
            << tag << " crosses the node at " << n.x << " " << n.y;
      (along == 'H' ? x : y) = to;
    }
  }
  EXPECT_EQ(lines, app->samples.size());
  for (const auto& [u, v] : app->samples)
    EXPECT_NE(svg.find("samples " + app->xnodes[static_cast<std::size_t>(u)].name),
              std::string::npos);
}

TEST(AppGraph, APictureIsBounded) {
  AppSpec app;
  app.name = "large";
  app.sources = {{"s", {10'000}}};
  for (int i = 0; i < 2'000; ++i) {
    app.xnodes.push_back({std::string(250, 'n'), std::string(250, 'm'), {{"cpu", 1'000}}, {}});
    if (i == 0) app.xnodes.back().sources = {0};
    for (int u = std::max(0, i - 20); u < i; ++u) app.edges.emplace_back(u, i);
  }
  const std::string svg = graph_svg(app, {});
  EXPECT_EQ(count(svg, "<path d=\"M"), kMostLines + 2);  // and two arrowheads
  EXPECT_LE(count(svg, "<rect"), 2 * kMostDrawn + 3);
  EXPECT_NE(svg.find("drawn are 400 of 2000 XNodes, 4000 of 39791 arrows"), std::string::npos);
  EXPECT_LT(svg.size(), std::size_t{8} << 20);
}

}  // namespace
}  // namespace xauto::story

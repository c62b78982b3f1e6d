// SPDX-License-Identifier: Apache-2.0
#include "xauto/windows.h"

#include <gtest/gtest.h>

#include "../story/count.h"

namespace xauto::cli {
namespace {

using test::count;

struct Drawn {
  AppSpec app;
  Platform platform{"p", {{"c0", "cpu"}}};
  Policy policy;

  Drawn() {
    app.name = "a<b";
    app.sources = {{"s", {10'000}}, {"t", {20'000}, 5'000}};
    app.xnodes = {{"x", "m", {{"cpu", 1'000}}, {0}}, {"y&z", "n", {{"cpu", 2'000}}, {1}}};
    app.modules = {{"m"}, {"n"}};
    app.chains = {{"c", 0, 0}};
    policy = {"a<b",
              app.hash(),
              "p",
              "test",
              {{0, {4'000}}, {0, {18'000}, {}, {0}, {3'000}}},
              {{"c", 4'000, 1'000, false}},
              0};
  }
  [[nodiscard]] std::string svg() const {
    const auto report = solver::keys::check(app, platform, policy);
    EXPECT_TRUE(report) << report.error().to_string();
    return windows_svg(app, platform, policy, *report);
  }
};

TEST(Windows, EveryJobOfAHyperperiodHasItsWindow) {
  const Drawn drawn;
  const std::string svg = drawn.svg();
  EXPECT_NE(svg.find("repeats every 20.000 ms"), std::string::npos);
  EXPECT_NE(svg.find("x 0 on c0: ready by 0.000, key 4.000 ms"), std::string::npos) << svg;
  EXPECT_NE(svg.find("x 1 on c0: ready by 10.000, key 14.000 ms"), std::string::npos);
  EXPECT_EQ(count(svg, "x 2 on c0"), 0u);
  // Its window ends after the picture, so that the one before reaches into it. Two bars each: the
  // window, and what is planned; that of before has ended by then.
  EXPECT_EQ(count(svg, "y&amp;z 0 on c0: ready by 5.000, key 23.000 ms"), 2u);
  EXPECT_EQ(count(svg, "y&amp;z -1 on c0: ready by -15.000, key 3.000 ms"), 1u);
  EXPECT_GE(count(svg, "class=\"window tight\""), 2u);  // one, and the legend's
}

TEST(Windows, NamesAreText) {
  const std::string svg = Drawn().svg();
  EXPECT_EQ(svg.find("a<b"), std::string::npos);
  EXPECT_NE(svg.find("a&lt;b"), std::string::npos);
}

TEST(Windows, ALongHyperperiodIsCut) {
  Drawn drawn;
  drawn.app.sources[1] = {"t", {19'997}};
  drawn.policy.app_hash = drawn.app.hash();
  const std::string svg = drawn.svg();
  EXPECT_NE(svg.find(" of 199970.000 ms"), std::string::npos);
  EXPECT_LE(count(svg, "<title>"), 2 * static_cast<std::size_t>(kMostWindows) + 10);
}

}  // namespace
}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// Line-ups: components one after the other.
#include <algorithm>
#include <array>

#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/line_up.h"
#include "solver/keys/solve.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// A source of its own, and XNodes one behind the other.
void add_component(AppSpec& app, std::int64_t period, const std::vector<std::int64_t>& wcets) {
  const int c = static_cast<int>(app.sources.size());
  app.sources.push_back({solver::test::numbered("s", c), {period, 1}});
  app.modules.push_back({solver::test::numbered("m", c), 1});
  for (std::size_t k = 0; k < wcets.size(); ++k) {
    XNodeSpec x;
    x.name = solver::test::numbered("x", static_cast<int>(app.xnodes.size()));
    x.module = app.modules.back().name;
    x.wcet_us = {{"cpu", wcets[k]}};
    if (k == 0) x.sources = {c};
    app.xnodes.push_back(x);
    const int here = static_cast<int>(app.xnodes.size()) - 1;
    if (k > 0) app.edges.emplace_back(here - 1, here);
  }
  app.chains.push_back(
      {solver::test::numbered("c", c), c, static_cast<int>(app.xnodes.size()) - 1});
}

Platform cpus(int count) {
  Platform platform;
  platform.name = "cpus";
  for (int m = 0; m < count; ++m)
    platform.xpus.push_back({solver::test::numbered("cpu", m), "cpu", true, 0});
  return platform;
}

TEST(KeysLineUp, TheLeastWorkGoesFirst) {
  AppSpec app;
  app.name = "line";
  for (const std::int64_t wcet : {4, 2, 3}) add_component(app, 100, {wcet});
  const Problem p = Problem::create(app, cpus(1)).value();
  LineUp lines(p);
  EXPECT_EQ(lines.by_weight(), (std::vector{1, 2, 0}));
  const LineUp::Value value = lines.plan(lines.by_weight(), {0, 0, 0}, {});
  EXPECT_EQ(lines.key(), (std::vector<Tick>{9, 2, 5}));
  EXPECT_EQ(value.sum, 16);
  EXPECT_EQ(value.largest, 9);
}

TEST(KeysLineUp, WhoComesLaterFillsTheGapsAndWaitsForItsHold) {
  AppSpec app;
  app.name = "gaps";
  add_component(app, 100, {10});
  add_component(app, 100, {4});
  const Problem p = Problem::create(app, cpus(1)).value();
  LineUp lines(p);
  // The first one begins at 3: the other one is there before, and goes on behind it.
  static_cast<void>(lines.plan({0, 1}, {3, 0}, {}));
  EXPECT_EQ(lines.key(), (std::vector<Tick>{13, 14}));
  static_cast<void>(lines.plan({0, 1}, {0, 20}, {}));
  EXPECT_EQ(lines.key(), (std::vector<Tick>{10, 24}));
}

TEST(KeysLineUp, LaterReleasesOfTheFirstAreInTheWay) {
  AppSpec app;
  app.name = "again";
  add_component(app, 10, {4});
  add_component(app, 100, {20});
  const Problem p = Problem::create(app, cpus(1)).value();
  LineUp lines(p);
  static_cast<void>(lines.plan({0, 1}, {0, 0}, {}));
  EXPECT_EQ(lines.key(), (std::vector<Tick>{4, 36}));  // 4 to 10, 14 to 20, 24 to 30, 34 to 36
}

TEST(KeysLineUp, WhatNoChainWaitsForComesLast) {
  AppSpec app;
  app.name = "rest";
  add_component(app, 100, {2, 5});
  app.chains.front().to = 0;
  add_component(app, 100, {3});
  const Problem p = Problem::create(app, cpus(1)).value();
  LineUp lines(p);
  static_cast<void>(lines.plan({0, 1}, {0, 0, 0}, {}));
  EXPECT_EQ(lines.key()[0], 2);
  EXPECT_EQ(lines.key()[2], 5);
  EXPECT_GE(lines.key()[1], 10);
}

/// Of two clocks on three CPUs and a GPU: the one with more work has two CPUs, and no XPU serves both.
TEST(KeysLineUp, ClocksApartShareNoXpu) {
  AppSpec app;
  app.name = "apart";
  app.clocks.push_back({"other", 100});
  for (int c = 0; c < 6; ++c) {
    add_component(app, 100, {c % 2 == 0 ? 20 : 5, 5});
    app.sources.back().clock = c % 2;
    app.xnodes.back().wcet_us["gpu"] = 2;
  }
  Platform platform = cpus(3);
  platform.xpus.push_back({"gpu0", "gpu", true, 50});
  const Problem p = Problem::create(app, platform).value();
  ASSERT_EQ(p.domains.size(), 2U);
  LineUp lines(p);
  const std::vector<Tick> hold(at(p.num_xnodes), 0);
  for (const bool free : {false, true}) {
    static_cast<void>(lines.plan(lines.by_weight(), hold, {.apart = true, .free = free}));
    std::vector<int> domain(at(p.num_xpus), -1);
    for (int i = 0; i < p.num_xnodes; ++i) {
      int& whose = domain[at(lines.xpu()[at(i)])];
      EXPECT_TRUE(whose == -1 || whose == p.domain_of(i)) << i;
      whose = p.domain_of(i);
    }
    EXPECT_EQ(std::count(domain.begin(), domain.end() - 1, p.domain_of(0)), 2);
    EXPECT_EQ(domain.back() == -1, free);
  }
}

/// Many components of several rates on few CPUs: near to what is proven of all together.
TEST(KeysLineUp, ManyComponentsEndOneAfterTheOther) {
  solver::test::Dice dice(5);
  AppSpec app;
  app.name = "many";
  for (int c = 0; c < 24; ++c) {
    const std::int64_t period = std::array{10'000, 20'000, 40'000}[at(c % 3)];
    std::vector<std::int64_t> wcets;
    for (int k = 0; k < 10; ++k) wcets.push_back(period * dice.roll(5, 15) / 2000);
    add_component(app, period, wcets);
    app.chains.back().deadline_us = 2 * period;
  }
  const Result<Answer> answer = solve(app, cpus(4), brief(60));
  ASSERT_TRUE(answer) << answer.error().to_string();
  ASSERT_EQ(answer->outcome, Outcome::kPolicy);
  EXPECT_LT(answer->totals.sum, 1.3 * answer->bounds.sum);
  EXPECT_TRUE(check(app, cpus(4), answer->policy));
}

}  // namespace
}  // namespace xauto::solver::keys

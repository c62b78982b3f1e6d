// SPDX-License-Identifier: Apache-2.0
// Clocks far worse than any: what solve answers, check accepts.
#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/keys/check.h"
#include "solver/keys/solve.h"

#include "../cases.h"
#include "problem_random.h"

namespace xauto::solver::keys {
namespace {

/// A component: a source, and XNodes one after the other.
void add(AppSpec& app, const SourceSpec& source, std::int64_t in_flight,
         const std::vector<std::int64_t>& wcets) {
  const int number = static_cast<int>(app.sources.size());
  const std::string module = "m" + std::to_string(number);
  app.sources.push_back(source);
  app.modules.push_back({module, in_flight, false});
  for (std::size_t i = 0; i < wcets.size(); ++i) {
    const int xnode = static_cast<int>(app.xnodes.size());
    app.xnodes.push_back({module + "." + std::to_string(i), module, {{"cpu", wcets[i]}}});
    if (i == 0)
      app.xnodes.back().sources = {number};
    else
      app.edges.emplace_back(xnode - 1, xnode);
  }
}

AppSpec named(std::vector<ClockSpec> clocks) {
  AppSpec app;
  app.name = "drift";
  app.clocks = std::move(clocks);
  return app;
}

Platform cpus(int count) {
  Platform platform;
  platform.name = "cpus";
  for (int i = 0; i < count; ++i) platform.xpus.push_back({"cpu" + std::to_string(i), "cpu"});
  return platform;
}

/// Whatever five seeds answer passes the check.
void expect_policies_that_pass(const AppSpec& app, const Platform& platform,
                               std::int64_t evaluations) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Options options;
    options.max_evaluations = evaluations;
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << answer.error().to_string();
    ASSERT_EQ(answer->outcome, Outcome::kPolicy);
    const auto report = check(app, platform, answer->policy);
    EXPECT_TRUE(report) << report.error().to_string();
  }
}

/// One CPU that does not preempt. The long job of the other clock may have just begun when a short one is released.
/// A pattern of a clock that drifts by 10 % is laid out twice as far as it is known: the solver took the end of the
/// busy time from beyond, and looked at no interval at all.
TEST(KeysDrift, TheLongJobOfABadClockBlocksTheShortOne) {
  AppSpec app = named({{"main", 100}, {"bad", 100'000}});
  add(app, {"s0", {2000}}, 1, {1, 20});
  add(app, {"s1", {3000}, 0, 0, 1}, 2, {118, 1});
  add(app, {"s2", {2000}}, 1, {1, 1});
  app.transfers = {{2, "cpu", "cpu", 40}};
  app.chains = {{"short", 0, 0, {}}};
  Platform platform = cpus(1);
  platform.xpus.front().preemptive = false;
  expect_policies_that_pass(app, platform, 5000);
}

/// Four rates of one clock, 2 % off, in a row.
AppSpec in_a_row() {
  AppSpec app = named({{"main", 20'000}});
  add(app, {"s1", {9973}, 4574}, 3, {4281, 476});
  add(app, {"s2", {7001}}, 2, {5});
  add(app, {"s3", {9973}}, 1, {580});
  add(app, {"s4", {9973}}, 2, {50, 122});
  app.samples = {{1, 2}, {2, 3}, {3, 4}};
  app.chains = {{"all", 0, 5, {}}};
  return app;
}

/// What comes to an activation by two ways, one that has kept its place on the clock and one whose latest start is
/// known: as one instant it would lose what drifts, twice. So a hold that nobody waits for cost 281 us.
TEST(KeysDrift, AHoldThatNobodyWaitsForCostsNoChain) {
  const AppSpec app = in_a_row();
  const Platform platform = cpus(6);
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {4572}}, {1, {5283}}, {2, {9}}, {3, {621}}, {4, {57}}, {5, {192}}};
  policy.chains = {{"all", 26'400, 0, false}};
  std::set<std::int64_t> derived;
  for (const std::int64_t hold : {0, 1, 8, 57, 70}) {
    policy.placements[5].hold_us = {hold};
    const auto report = check(app, platform, policy);
    ASSERT_TRUE(report) << report.error().to_string();
    derived.insert(report->chains.front().derived_us);
  }
  EXPECT_EQ(derived, std::set<std::int64_t>{26'044});
}

TEST(KeysDrift, OfAWayAlongABadClockCheckDerivesNoMore) {
  Options options;
  options.max_evaluations = 5;
  const auto answer = solve(in_a_row(), cpus(6), options);
  ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
  const auto report = check(in_a_row(), cpus(6), answer->policy);
  EXPECT_TRUE(report) << report.error().to_string();
}

/// Two windows of 400 us, of one clock. Whichever begins first ends first, however far the clock drifts: neither of both
/// preempts, so neither pays. With 60 us for each, or for one, they would not fit.
TEST(KeysDrift, WindowsOfOneLengthDoNotPreemptEachOther) {
  AppSpec app = named({{"main", 20'000}});
  add(app, {"s0", {1000}}, 1, {100});
  add(app, {"s1", {3000}}, 1, {250});
  app.chains = {{"all", 0, 0, {}}};
  Platform platform = cpus(1);
  platform.xpus.front().preempt_us = 60;
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {400}}, {0, {1400}, {1000}}};
  policy.chains = {{"all", 400, 0, false}};
  const auto report = check(app, platform, policy);
  EXPECT_TRUE(report) << report.error().to_string();
  policy.placements[1].key_us = {1401};  // now the first one may preempt the second
  EXPECT_FALSE(check(app, platform, policy));
}

/// Back and forth between two rates of a clock that is planned in groups. The solver follows the way back into a group from
/// that group's first visit on; so does check, though the latest start at the visit in between is sooner there.
TEST(KeysDrift, AWayBackIntoAGroupIsCountedFromItsFirstVisitOn) {
  AppSpec app = named({{"main", 50'000}});
  add(app, {"s0", {3333}, 1318, 589}, 2, {730});
  add(app, {"s1", {5000}, 0, 331}, 2, {2356, 2586});
  add(app, {"s2", {3333}}, 2, {141});
  add(app, {"s3", {5000}, 271}, 2, {1001});
  add(app, {"rare", {999'983}}, 1, {1});
  app.samples = {{0, 2}, {2, 3}, {3, 4}, {0, 4}};
  app.chains = {{"all", 0, 4, {}}, {"second", 1, 4, {}}};
  Platform platform = cpus(5);
  platform.xpus[1].preemptive = platform.xpus[4].preemptive = false;
  expect_policies_that_pass(app, platform, 100);
}

constexpr std::int64_t kPpms[] = {0, 100, 20'000, 100'000};

/// Components of two or three rates in a row by samples, mostly of one clock: its ways go back and forth. Often a rate more
/// that meets the others late, so that the clock is planned in groups.
AppSpec random_row(solver::test::Dice& dice, int xpus) {
  AppSpec app = named({{"main", kPpms[dice.roll(0, 3)]}, {"other", kPpms[dice.roll(0, 3)]}});
  const std::int64_t periods[][3] = {
      {1000, 1500, 2000}, {701, 997, 1402}, {3333, 5000, 6666}, {701, 997, 701}};
  const auto& rates = periods[dice.roll(0, 3)];
  const bool groups = dice.chance(40), two_clocks = dice.chance(30);
  const int components = dice.roll(3, 6);
  std::vector<std::pair<int, int>> ends;  // of each component
  for (int c = 0; c < components; ++c) {
    SourceSpec source{"s" + std::to_string(c), {rates[dice.chance(70) ? c % 2 : dice.roll(0, 2)]}};
    const int period = static_cast<int>(source.period.num);
    if (dice.chance(50)) source.offset_us = dice.roll(0, period - 1);
    if (dice.chance(30)) source.jitter_us = dice.roll(0, period / 3);
    source.clock = two_clocks && dice.chance(30) ? 1 : 0;
    std::vector<std::int64_t> wcets;
    const int most = std::max(2, period * xpus / (3 * components));
    for (int i = dice.roll(1, 2); i > 0; --i)
      wcets.push_back(dice.roll(1, dice.chance(50) ? 2 + most / 10 : most));
    const int first = static_cast<int>(app.xnodes.size());
    add(app, source, dice.roll(1, 3), wcets);
    ends.emplace_back(first, static_cast<int>(app.xnodes.size()) - 1);
    if (c > 0) app.samples.emplace_back(ends[at(c) - 1].second, first);
  }
  app.chains = {{"all", 0, ends.back().second, {}}, {"first", 0, ends.front().first, {}}};
  if (groups) add(app, {"rare", {999'983}}, 1, {1});
  return app;
}

/// Components of two clocks with little to do, and nothing between them.
AppSpec random_beside(solver::test::Dice& dice) {
  AppSpec app = named({{"main", kPpms[dice.roll(0, 3)]}, {"other", kPpms[dice.roll(0, 3)]}});
  for (int c = 0; c < 3; ++c) {
    SourceSpec source{"s" + std::to_string(c), {1000 * dice.roll(1, 3)}};
    source.clock = c % 2;
    std::vector<std::int64_t> wcets;
    for (int i = dice.roll(1, 3); i > 0; --i)
      wcets.push_back(dice.chance(60) ? dice.roll(1, 3) : dice.roll(10, 150));
    const std::size_t edges = app.edges.size();
    add(app, source, dice.roll(1, 2), wcets);
    if (wcets.size() > 1 && dice.chance(50))
      app.transfers.push_back({static_cast<int>(edges), "cpu", "cpu", dice.roll(1, 60)});
  }
  app.chains = {{"first", 0, 0, {}}, {"last", 2, static_cast<int>(app.xnodes.size()) - 1, {}}};
  return app;
}

TEST(KeysDrift, WhatSolveAnswersPassesTheCheck) {
  const int apps = xauto::test::cases(16, 150);
  int policies = 0, gated = 0;
  for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(apps); ++seed) {
    solver::test::Dice dice(seed);
    const bool row = dice.chance(50);
    Platform platform = cpus(row ? dice.roll(2, 6) : 1);
    for (Xpu& xpu : platform.xpus) {
      xpu.preemptive = row && dice.chance(70);
      if (xpu.preemptive && dice.chance(30)) xpu.preempt_us = 7;
    }
    const AppSpec app =
        row ? random_row(dice, static_cast<int>(platform.xpus.size())) : random_beside(dice);
    Options options;
    options.max_evaluations = row ? 30 : 300;
    // Where clocks are split and 12 000 jobs are held, all of the time goes into who need not be.
    options.time_limit_s = 1;
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << seed << ": " << answer.error().to_string();
    if (answer->outcome != Outcome::kPolicy) continue;
    ++policies;
    gated += platform.xpus.front().preemptive ? 0 : 1;
    const auto report = check(app, platform, answer->policy);
    EXPECT_TRUE(report) << seed << ": " << report.error().to_string();
  }
  EXPECT_GE(policies, apps / 2);
  EXPECT_GE(gated, apps / 5);
}

}  // namespace
}  // namespace xauto::solver::keys

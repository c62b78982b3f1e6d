// SPDX-License-Identifier: Apache-2.0
// The worst case of a chain: the solver's count against the checker's, which share no code.
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/periodic.h"
#include "solver/keys/certificate.h"
#include "solver/keys/chains.h"
#include "solver/keys/check.h"
#include "solver/keys/problem.h"
#include "solver/keys/solve.h"

#include "../cases.h"
#include "keys_random.h"
#include "problem_random.h"

namespace xauto::solver::keys {
namespace {

/// From a camera through three stages on another clock, each of which samples the one before. The last one
/// is held for so long that it begins before what it reads is released: the way goes back on the clock.
AppSpec going_back(int ppm) {
  AppSpec app;
  app.name = "back";
  app.clocks = {{"main", 0}, {"other", ppm}};
  app.sources = {{"camera", {10'000}},
                 {"u", {40'000}, 0, 0, 1},
                 {"v", {50'000}, 0, 0, 1},
                 {"w", {100'000}, 0, 0, 1}};
  for (int i = 0; i < 4; ++i) {
    const std::string name(1, "xuvw"[i]);
    app.modules.push_back({name, 2, false});
    app.xnodes.push_back({name, name, {{"cpu", 500}}, {i}});
  }
  app.samples = {{0, 1}, {1, 2}, {2, 3}};
  app.chains = {{"all", 0, 3, {}}};
  return app;
}

TEST(KeysChains, ACheckDerivesNoMoreWhereAWayGoesBackOnAClockThatDrifts) {
  Platform platform;
  platform.name = "four";
  for (int i = 0; i < 4; ++i) platform.xpus.push_back({"cpu" + std::to_string(i), "cpu"});
  for (const int ppm : {0, 100, 1000, 5000}) {
    const AppSpec app = going_back(ppm);
    const Problem p = *Problem::create(app, platform);
    Policy keys;
    keys.app = app.name;
    keys.app_hash = app.hash();
    keys.placements = {{0, {1000}, {}, {}, {}},
                       {1, {5000, 9000, 5000, 9000, 6000}, {0, 4000, 0, 4000, 1000}, {}, {}},
                       {2, {20'000}, {}, {}, {}},
                       {3, {145'000}, {140'000}, {}, {}}};
    std::vector<int> xpu;
    for (const Placement& placed : keys.placements) xpu.push_back(placed.xpu);
    Windows w = keys_and_holds(p, keys);
    std::string why;
    ASSERT_TRUE(certify(p, xpu, w, &why)) << why;
    const Tick worst = p.up_to_us(worst_case(p, p.chains[0], w, false)) / p.scale;
    keys.chains = {{"all", worst, 0, false}};
    const auto report = check(app, platform, keys);
    ASSERT_TRUE(report) << ppm << ": " << report.error().to_string();
    EXPECT_LE(report->chains[0].derived_us, worst);
    EXPECT_GE(report->chains[0].derived_us, worst - 5);
  }
}

/// A camera of 33 333 us beside another rate on its clock, and a LiDAR's clock between them: the releases of one
/// clock come round after 50 000, and a way crosses clocks `crossings` times. Whoever followed each release
/// behind each crossing again would not come to an end.
TEST(KeysChains, WhatIsBehindACrossingIsFollowedOnce) {
  Platform platform;
  platform.name = "four";
  for (int i = 0; i < 4; ++i) platform.xpus.push_back({"cpu" + std::to_string(i), "cpu"});
  AppSpec app;
  app.name = "three";
  app.clocks = {{"main", 0}, {"lidar", 50}};
  app.sources = {
      {"a", {33'333}}, {"b", {99'991}, 0, 0, 1}, {"c", {50'000}}, {"d", {70'001}, 0, 0, 1}};
  Policy keys;
  for (int i = 0; i < 4; ++i) {
    const std::string name(1, "abcd"[i]);
    app.modules.push_back({name, 1, false});
    app.xnodes.push_back({name, name, {{"cpu", 500}}, {i}});
    keys.placements.push_back({i, {510}});  // drift costs some
  }
  app.samples = {{0, 1}, {1, 2}, {2, 3}};
  app.chains = {{"all", 0, 3, {}}};
  keys.app = app.name;
  keys.app_hash = app.hash();
  const Problem p = *Problem::create(app, platform);
  Windows w = keys_and_holds(p, keys);
  std::string why;
  ASSERT_TRUE(certify(p, {0, 1, 2, 3}, w, &why)) << why;
  const Tick worst = p.up_to_us(worst_case(p, p.chains[0], w, false)) / p.scale;
  // Each result just missed, of the camera too, and periods of a slow clock.
  EXPECT_EQ(worst, 510 + (510 + 99'996) + (510 + 50'000) + (510 + 70'005) + 2);
  keys.chains = {{"all", worst, 0, false}};
  const auto report = check(app, platform, keys);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_LE(report->chains.front().derived_us, worst);
}

/// One clock, whose rates meet so late that it is planned in groups, and a way that goes back and forth between two
/// of them: their phases to each other are known all the same, by `check` too.
TEST(KeysChains, AWayBackAndForthBetweenGroupsOfOneClockIsWhatCheckDerives) {
  AppSpec app;
  app.name = "groups";
  app.clocks = {{"main", 0}};
  const auto add = [&](const std::string& name, std::int64_t period) {
    const int i = static_cast<int>(app.xnodes.size());
    app.sources.push_back({"of " + name, {period}});
    app.modules.push_back({name, 1, false});
    app.xnodes.push_back({name, name, {{"cpu", 30}}, {i}});
  };
  for (const char* name : {"x0", "x1", "x2", "x3", "x4", "x5"}) {
    add(name, app.xnodes.size() % 2 == 0 ? 1000 : 1001);
    if (app.xnodes.size() > 1)
      app.samples.emplace_back(static_cast<int>(app.xnodes.size()) - 2,
                               static_cast<int>(app.xnodes.size()) - 1);
  }
  for (const std::int64_t period : {1'000'000, 1'001'000, 997'000})
    add("y" + std::to_string(period), period);
  for (int to = 1; to < 6; ++to) app.chains.push_back({"to " + std::to_string(to), 0, to, {}});
  Options options;
  options.max_evaluations = 200;
  const Platform platform = *Platform::builtin("small");
  const auto answer = solve(app, platform, options);
  ASSERT_TRUE(answer) << answer.error().to_string();
  ASSERT_EQ(answer->outcome, Outcome::kPolicy);
  const auto report = check(app, platform, answer->policy);
  EXPECT_TRUE(report) << report.error().to_string();
}

/// A way into a group of components from another one of its clock: where all rates together come round too late to
/// be followed, `check` still knows the phases inside the group.
TEST(KeysChains, PhasesInsideAGroupAreKnownWhereverTheWayComesFrom) {
  AppSpec app;
  app.name = "into";
  app.clocks = {{"main", 20}};
  app.sources = {
      {"a", {66'667}}, {"b", {10'000}}, {"c", {12'500}}, {"d", {5'000}}, {"e", {40'000}}};
  const char* names[] = {"a", "b", "c", "d", "e"};
  for (int i = 0; i < 5; ++i) {
    app.modules.push_back({names[i], 1, false});
    app.xnodes.push_back({names[i], names[i], {{i == 0 ? "gpu" : "cpu", 100 + 400 * i}}, {i}});
  }
  app.samples = {{0, 1}, {1, 2}, {2, 3}, {4, 3}};
  app.chains = {{"all", 0, 3, {}}, {"e", 4, 3, {}}};
  const Platform platform{"two", {{"cpu0", "cpu"}, {"gpu0", "gpu"}}};
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Options options;
    options.max_evaluations = 60;
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
    const auto report = check(app, platform, answer->policy);
    EXPECT_TRUE(report) << report.error().to_string();
  }
}

/// What it left the time before: no chain, and no reason to refuse the app.
TEST(KeysChains, AnXNodeMaySampleItself) {
  AppSpec app = going_back(0);
  app.chains = {{"all", 0, 3, {}}};
  Options options;
  options.max_evaluations = 50;
  const Platform platform = *Platform::builtin("small");
  std::vector<std::int64_t> worst;
  for (int round = 0; round < 2; ++round) {
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
    const auto report = check(app, platform, answer->policy);
    ASSERT_TRUE(report) << report.error().to_string();
    worst.push_back(report->chains.front().derived_us);
    app.samples.emplace_back(3, 3);
  }
  EXPECT_EQ(worst.front(), worst.back());
}

/// Components of three rates that nearly are one another's multiples, beside three whose rates meet after hours: their
/// clocks are planned in groups.
AppSpec random_groups(std::uint64_t seed) {
  solver::test::Dice dice(seed);
  AppSpec app;
  app.name = "random";
  app.clocks = {{"main", 50 * dice.roll(0, 2)}, {"own", 50 * dice.roll(0, 20)}};
  const bool two_clocks = dice.roll(0, 2) == 0;
  const auto add = [&](std::int64_t period, std::int64_t wcet, bool free) {
    const int source = static_cast<int>(app.sources.size()),
              xnode = static_cast<int>(app.xnodes.size());
    const std::string name = "m" + std::to_string(source);
    app.sources.push_back({"s" + name, {period}});
    if (free && dice.roll(0, 2) == 0)
      app.sources.back().offset_us = dice.roll(0, static_cast<int>(period) - 1);
    if (free && dice.roll(0, 2) == 0) app.sources.back().jitter_us = period / 20;
    if (free && two_clocks && dice.roll(0, 2) == 0) app.sources.back().clock = 1;
    app.modules.push_back({name, 1, false});
    app.xnodes.push_back({name + ".0", name, {{"cpu", wcet}}, {source}});
    if (!free || dice.roll(0, 1) == 0) return;
    app.xnodes.push_back({name + ".1", name, {{"cpu", wcet}}});
    app.edges.emplace_back(xnode, xnode + 1);
  };
  const std::int64_t rates[] = {1000, 1001, 997, 2000, 2002, 1994, 10'000, 10'010, 9970};
  for (int left = dice.roll(4, 9); left > 0; --left)
    add(rates[dice.roll(0, 8)], dice.roll(5, 40), true);
  const int size = static_cast<int>(app.xnodes.size());
  for (const std::int64_t period : {1'000'000, 1'001'000, 997'000}) add(period, 30, false);
  std::set<std::pair<int, int>> there;
  for (int k = dice.roll(3, 9); k > 0; --k) {
    const int u = dice.roll(0, size - 1), v = dice.roll(0, size - 1);
    if (app.xnodes[at(u)].module != app.xnodes[at(v)].module && there.emplace(u, v).second)
      app.samples.emplace_back(u, v);
  }
  complete_chains(app);
  return app;
}

TEST(KeysChains, OfRandomGroupsCheckDerivesNoMore) {
  const Platform platform = *Platform::builtin("small");
  const int apps = xauto::test::cases(8, 40);
  int solved = 0;
  for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(apps); ++seed) {
    const AppSpec app = random_groups(seed);
    Options options;
    options.max_evaluations = 40;
    options.threads = 1;
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << seed << ": " << answer.error().to_string();
    if (answer->outcome != Outcome::kPolicy) continue;
    ++solved;
    const auto report = check(app, platform, answer->policy);
    EXPECT_TRUE(report) << seed << ": " << report.error().to_string();
  }
  EXPECT_GE(4 * solved, 3 * apps);
}

/// Where a clock drifts, several readers may be the first that knows: each counts by what is known of it alone.
TEST(KeysChains, WhereClocksDriftCheckDerivesNoLess) {
  int chains = 0;
  for (const int ppm : {2'000, 20'000, 100'000})
    for (std::uint64_t seed = 1; seed <= 150; ++seed) {
      solver::test::Dice dice(seed);
      RatedShape shape;
      shape.clocks = 2;
      shape.max_components = 6;
      shape.least_period = 16;
      shape.ppm = ppm;
      Platform platform = random_rated_platform(dice);
      for (const char* more : {"1", "2", "3"}) {
        platform.xpus.push_back({std::string("cpu8") + more, "cpu", true, 0});
        platform.xpus.push_back({std::string("gpu8") + more, "gpu", true, 0});
      }
      AppSpec app = random_rated_app(dice, shape);
      for (SourceSpec& source : app.sources) source.clock = dice.chance(80) ? 1 : 0;
      stretch(app, platform, 1000);
      Options options;
      options.max_evaluations = 60;
      options.seed = seed;
      const auto answer = solve(app, platform, options);
      ASSERT_TRUE(answer) << seed;
      if (answer->outcome != Outcome::kPolicy) continue;
      const auto report = check(app, platform, answer->policy);
      ASSERT_TRUE(report) << seed << ": " << report.error().to_string();
      for (const ChainProof& chain : report->chains) {
        // A microsecond of rounding at each sample, and one at the end.
        EXPECT_LE(chain.claimed_us, chain.derived_us + 5)
            << ppm << " ppm, " << seed << ", " << chain.name;
        ++chains;
      }
    }
  EXPECT_GT(chains, 200);
}

}  // namespace
}  // namespace xauto::solver::keys

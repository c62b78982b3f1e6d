// SPDX-License-Identifier: Apache-2.0
// Pins, groups, chains and deadlines: kept by every answer, refused with names where they cannot
// be.
#include "solver/objectives.h"

#include <set>

#include <gtest/gtest.h>

#include "solver/bounds.h"
#include "solver/evaluate.h"
#include "solver/generate.h"
#include "solver/solve.h"

#include "brute_force.h"
#include "problem_random.h"
#include "reference/valid_plan.h"

namespace xauto::solver {
namespace {

SolveOptions counted() {
  SolveOptions options;
  options.max_evaluations = 6000;
  options.time_limit_s = 1e9;
  return options;
}

/// Two sensors' chains that compete for one gpu, 10 ms each.
AppSpec two_chains() {
  AppSpec app;
  app.name = "two";
  app.xnodes = {{"a.in", "A", {{"cpu", 1000}}},
                {"a.out", "A", {{"gpu", 10'000}}},
                {"b.in", "B", {{"cpu", 1000}}},
                {"b.out", "B", {{"gpu", 10'000}}}};
  app.edges = {{0, 1}, {2, 3}};
  return app;
}

Platform one_of_each() {
  Platform platform;
  platform.name = "one of each";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1},
                   {"cpu1", "cpu", true, 0, 0, -1},
                   {"gpu0", "gpu", true, 100, 0, -1}};
  return platform;
}

TEST(Objectives, PinsForbidsAndGroupsAreKept) {
  const Platform platform = Platform::builtin("small").value();
  GenerateOptions shape;
  shape.nodes = 20;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    shape.seed = seed;
    const AppSpec app = generate(shape).value();
    SolveOptions options = counted();
    const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
    options.objectives.pins = {{name(0), "cpu2"}};
    options.objectives.forbids = {{name(1), "gpu"}};
    options.objectives.groups = {{name(3), name(4), name(5)}};
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value()) << policy.error().to_string();
    const auto xpu = [&](std::size_t i) {
      return platform.xpus[static_cast<std::size_t>(policy->placements[i].xpu)];
    };
    EXPECT_EQ(xpu(0).id, "cpu2");
    EXPECT_NE(xpu(1).type, "gpu");
    EXPECT_EQ(xpu(3).id, xpu(4).id);
    EXPECT_EQ(xpu(4).id, xpu(5).id);
    EXPECT_TRUE(reference::validate_plan(*policy, app, platform).has_value());
  }
}

/// Six stages of 5 ms side by side, one CPU for all of them or one for their group.
TEST(Objectives, WhatIsPinnedOrGroupedIsItsXpusLoad) {
  AppSpec app;
  app.name = "six";
  for (int i = 0; i < 6; ++i) app.xnodes.push_back({test::numbered("x", i), "m", {{"cpu", 5000}}});
  const Platform platform = Platform::builtin("small").value();
  Objectives pinned, grouped;
  for (const XNodeSpec& x : app.xnodes) pinned.pins.emplace_back(x.name, "cpu1");
  grouped.groups.emplace_back();
  for (const XNodeSpec& x : app.xnodes) grouped.groups.front().push_back(x.name);
  for (const Objectives& asked : {pinned, grouped}) {
    SolveOptions options = counted();
    options.objectives = asked;
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value()) << policy.error().to_string();
    EXPECT_EQ(policy->latency_us, 30'000);
    EXPECT_EQ(policy->lower_bound_us, 30'000);
    EXPECT_TRUE(policy->optimal);
  }
}

/// Exhaustion over the one XPU that the group shares, in turn.
TEST(Objectives, TheBoundOfAGroupHoldsAgainstExhaustion) {
  test::Dice dice(21);
  int grouped = 0;
  for (int round = 0; round < 200; ++round) {
    test::Shape shape;
    shape.min_nodes = 3;
    shape.max_nodes = 5;
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    Objectives asked;
    asked.groups = {{app.xnodes[0].name, app.xnodes[1].name, app.xnodes[2].name}};
    Problem p = *Problem::create(app, platform);
    if (!resolve(asked, app, platform, p)) continue;  // no XPU can run all of them
    ++grouped;
    Time best = kNever;
    for (int x = 0; x < p.num_xpus; ++x) {
      if (p.wcet_on(0, x) == kCannotRun) continue;
      std::vector<std::pair<int, int>> elsewhere;
      for (int i = 0; i < 3; ++i)
        for (int y = 0; y < p.num_xpus; ++y)
          if (y != x) elsewhere.emplace_back(i, y);
      const test::Apart apart = test::instance_by_instance(app, platform, elsewhere);
      best =
          std::min(best, test::brute_force(*Problem::create(apart.app, apart.platform)).makespan);
    }
    ASSERT_LE(quick_bound(p), best) << "round " << round;
  }
  EXPECT_GT(grouped, 50);
}

TEST(Objectives, WithAPinTheBoundStillHoldsAgainstExhaustion) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(seed);
    const Platform platform = test::random_platform(dice, {});
    const AppSpec app = test::random_app(dice, {}, platform);
    SolveOptions options = counted();
    const std::string type = app.xnodes[0].wcet_us.begin()->first;
    options.objectives.pins = {
        {app.xnodes[0].name,
         platform.xpus[static_cast<std::size_t>(platform.instances_of(type).front())].id}};
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value());
    Problem problem = Problem::create(app, platform).value();
    ASSERT_TRUE(resolve(options.objectives, app, platform, problem).has_value());
    const Time exhausted = test::brute_force(problem).makespan;
    EXPECT_LE(policy->lower_bound_us, exhausted) << "seed " << seed;
    if (policy->optimal) {
      EXPECT_LE(policy->latency_us, exhausted) << "seed " << seed;
    }
  }
}

TEST(Objectives, ADeadlineDecidesWhoWaits) {
  for (const bool a_first : {true, false}) {
    SolveOptions options = counted();
    options.objectives.chains = {{"a", "a.in", "a.out", a_first ? 11'000 : 21'000},
                                 {"b", "b.in", "b.out", a_first ? 21'000 : 11'000}};
    const auto policy = solve(two_chains(), one_of_each(), options);
    ASSERT_TRUE(policy.has_value());
    EXPECT_EQ(policy->placements[a_first ? 1 : 3].finish_us, 11'000);
    EXPECT_EQ(policy->placements[a_first ? 3 : 1].finish_us, 21'000);
  }
}

TEST(Objectives, WhatCannotBeIsRefusedByName) {
  const auto error_of = [&](const Objectives& objectives) {
    SolveOptions options = counted();
    options.objectives = objectives;
    const auto policy = solve(two_chains(), one_of_each(), options);
    return policy ? Error{} : policy.error();
  };
  Objectives objectives;
  objectives.pins = {{"nobody", "cpu0"}};
  EXPECT_NE(error_of(objectives).what.find("nobody"), std::string::npos);
  objectives = {};
  objectives.pins = {{"a.in", "tpu7"}};
  EXPECT_NE(error_of(objectives).what.find("tpu7"), std::string::npos);
  objectives = {};
  objectives.pins = {{"a.in", "gpu0"}};
  EXPECT_EQ(error_of(objectives).code, ErrorCode::kInfeasible);
  objectives = {};
  objectives.groups = {{"a.in", "a.out"}};
  EXPECT_EQ(error_of(objectives).code, ErrorCode::kInfeasible);
  objectives = {};
  objectives.chains = {{"odd", "a.in", "b.out", {}}};
  EXPECT_EQ(error_of(objectives).code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// The bound for large apps, against exhaustion, random schedules, and cases worked out by hand; and
// the starts that its prices make.
#include "solver/composite.h"

#include <gtest/gtest.h>

#include "solver/bounds.h"
#include "solver/construct.h"
#include "solver/generate.h"
#include "solver/ordered.h"
#include "solver/simulate.h"

#include "brute_force.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

Platform machines(int cpus) {
  Platform platform;
  platform.name = "p";
  for (int k = 0; k < cpus; ++k)
    platform.xpus.push_back({"cpu" + std::to_string(k), "cpu", true, 0, 0, -1});
  return platform;
}

TEST(Composite, IsNeverAboveTheBestOfAllPoliciesOrAnyOrderedSchedule) {
  int met = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    test::Dice dice(60'000 + seed);
    test::Shape shape;
    shape.max_nodes = 6;
    const Platform platform = test::random_platform(dice, shape);
    const Problem problem = *Problem::create(test::random_app(dice, shape, platform), platform);
    Time best = test::brute_force(problem).makespan;
    OrderedEvaluator ordered(problem);
    for (int k = 0; k < 30; ++k) {
      const Decision decision = test::random_decision(dice, problem);
      ordered.reset(decision.xpu, sequence_of(decision.priority));
      best = std::min(best, ordered.makespan());
    }
    for (const int effort : {0, 1}) ASSERT_LE(composite_bound(problem, effort).bound, best) << seed;
    met += composite_bound(problem).bound == best;
  }
  EXPECT_GT(met, 280);
}

TEST(Composite, HeadsAndTailsHoldInEverySchedule) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(70'000 + seed);
    test::Shape shape;
    shape.max_nodes = 14;
    const Platform platform = test::random_platform(dice, shape);
    const Problem problem = *Problem::create(test::random_app(dice, shape, platform), platform);
    const CompositeBound bound = composite_bound(problem);
    const std::vector<Time> heads = static_heads(problem);
    for (int k = 0; k < 40; ++k) {
      const Simulation s = simulate(problem, test::random_decision(dice, problem));
      for (std::size_t i = 0; i < heads.size(); ++i) {
        ASSERT_GE(bound.heads[i], heads[i]);
        ASSERT_LE(bound.heads[i], s.start[i]) << seed;
        ASSERT_LE(bound.tails[i], s.makespan - s.finish[i]) << seed;
      }
    }
  }
}

TEST(Composite, StagesOneBehindTheOtherAddUp) {
  // Two forks of three XNodes of 10 on two CPUs: each takes 15 at least, the join between them 1.
  AppSpec app;
  app.name = "stages";
  for (const char* name : {"a", "b", "c", "join", "d", "e", "f"})
    app.xnodes.push_back({name, "m", {{"cpu", 10}}});
  app.xnodes[3].wcet_us = {{"cpu", 1}};
  app.edges = {{0, 3}, {1, 3}, {2, 3}, {3, 4}, {3, 5}, {3, 6}};
  const Problem problem = *Problem::create(app, machines(2));
  const CompositeBound bound = composite_bound(problem);
  EXPECT_EQ(bound.heads[3], 15);
  EXPECT_EQ(bound.tails[3], 15);
  EXPECT_EQ(bound.bound, 31);
}

TEST(Composite, OneXNodeCannotKeepTwoCpusBusy) {
  // 4 alone, then 10 and 10, then 4 alone: 18 on two CPUs; the load alone would be 14.
  AppSpec app;
  app.name = "diamond";
  app.xnodes = {{"a", "m", {{"cpu", 4}}},
                {"b", "m", {{"cpu", 10}}},
                {"c", "m", {{"cpu", 10}}},
                {"d", "m", {{"cpu", 4}}}};
  app.edges = {{0, 1}, {0, 2}, {1, 3}, {2, 3}};
  const Problem two = *Problem::create(app, machines(2));
  EXPECT_EQ(load_bound(two), 14);
  EXPECT_EQ(composite_bound(two).bound, 18);
  // A head of one and a tail of another do not add up: with three CPUs one stays idle.
  AppSpec apart;
  apart.name = "apart";
  apart.xnodes = {{"early", "m", {{"cpu", 1}}},
                  {"long", "m", {{"cpu", 100}}},
                  {"before", "m", {{"cpu", 100}}},
                  {"late", "m", {{"cpu", 1}}}};
  apart.edges = {{0, 1}, {2, 3}};
  EXPECT_EQ(composite_bound(*Problem::create(apart, machines(3))).bound, 101);
}

TEST(Composite, PricedStartsAreWholeAndBetterThanNoneOnALargeApp) {
  GenerateOptions options;
  options.nodes = 150;
  options.seed = 4;
  const AppSpec app = *generate(options);
  for (const char* name : {"small", "large"}) {
    const Problem problem = *Problem::create(app, *Platform::builtin(name));
    const CompositeBound bound = composite_bound(problem);
    Time best = kNever;
    for (const Solution& s : priced_solutions(problem, bound)) {
      EXPECT_EQ(simulate(problem, to_decision(s)).makespan, s.makespan);
      EXPECT_GE(s.makespan, bound.bound);
      best = std::min(best, s.makespan);
    }
    EXPECT_LE(best, constructive_solutions(problem).front().makespan);
  }
}

}  // namespace
}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// What is claimed to be proven, against exhaustion; and the bounds against schedules that exist.
#include "solver/exact.h"

#include <gtest/gtest.h>

#include "solver/bounds.h"
#include "solver/ordered.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "brute_force.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

SolveOptions counted(std::int64_t evaluations) {
  SolveOptions options;
  options.max_evaluations = evaluations;
  options.time_limit_s = 1e9;
  return options;
}

struct Agreement {
  int cases = 0, optimal = 0, ordered = 0;
};

Agreement compare_with_exhaustion(const test::Shape& shape, std::uint64_t first_seed, int cases) {
  Agreement agreement;
  for (int k = 0; k < cases; ++k) {
    test::Dice dice(first_seed + static_cast<std::uint64_t>(k));
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    const auto problem = Problem::create(app, platform);
    EXPECT_TRUE(problem.has_value());
    const auto policy = solve(app, platform, counted(4000));
    EXPECT_TRUE(policy.has_value());
    const Time exhausted = test::brute_force(*problem).makespan;
    ++agreement.cases;
    EXPECT_LE(policy->lower_bound_us, exhausted) << "case " << k;
    EXPECT_LE(policy->lower_bound_us, policy->latency_us) << "case " << k;
    EXPECT_EQ(policy->optimal, policy->lower_bound_us == policy->latency_us) << "case " << k;
    if (policy->order.empty()) {
      EXPECT_GE(policy->latency_us, exhausted) << "case " << k;
    } else {
      ++agreement.ordered;
    }
    if (policy->optimal) {
      ++agreement.optimal;
      EXPECT_LE(policy->latency_us, exhausted) << "case " << k;
    }
  }
  return agreement;
}

TEST(Exact, OptimalAgreesWithExhaustionWherePreemptionIsFree) {
  test::Shape shape;
  shape.max_preempt = 0;
  shape.non_preemptive_percent = 0;
  const Agreement agreement = compare_with_exhaustion(shape, 1000, 250);
  // The fixed-priority class reaches the optimum here, so nearly all are proven.
  EXPECT_GE(agreement.optimal, 248);
}

TEST(Exact, OptimalAgreesWithExhaustionWithCostsAndNonPreemptiveXpus) {
  const Agreement agreement = compare_with_exhaustion(test::Shape{}, 5000, 350);
  EXPECT_GE(agreement.optimal, 340);
  EXPECT_GT(agreement.ordered, 0);
}

TEST(Exact, NoScheduleOfAnyKindIsBelowAProvenBound) {
  // Ordered schedules with inserted idle time, drawn at random: a class the exhaustion does not
  // cover.
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    test::Dice dice(9000 + seed);
    test::Shape shape;
    shape.max_nodes = 12;
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    const auto problem = Problem::create(app, platform);
    ASSERT_TRUE(problem.has_value());
    std::atomic<Time> incumbent{kNever};
    const Time horizon = 12 * 12 + 1;
    incumbent.store(horizon);
    ProofControl control;
    control.incumbent = &incumbent;
    control.max_lps = 300;
    const Time bound = prove_bound(*problem, control);
    EXPECT_GE(bound, quick_bound(*problem));
    OrderedEvaluator ordered(*problem);
    for (int k = 0; k < 200; ++k) {
      const Decision decision = test::random_decision(dice, *problem);
      ASSERT_GE(simulate(*problem, decision).makespan, bound) << "seed " << seed;
      ordered.reset(decision.xpu, sequence_of(decision.priority));
      ASSERT_GE(ordered.makespan(), bound) << "seed " << seed;
    }
  }
}

TEST(Exact, WhoeverSuspendsPaysSoThatOneMicrosecondLessIsRefuted) {
  // gpu: long 10 from 0; short 2 is ready at 4 and must be followed by 6 on the cpu. Interrupting
  // costs 1, which the short one pays before it works: 4 + 1 + 2 + 6 = 13, long ends at 13. If the
  // long one could pay in advance, 12 would do. Without interrupting: 10 + 2 + 6 = 18.
  AppSpec app;
  app.name = "nested";
  app.xnodes = {{"first", "m", {{"cpu", 4}}},
                {"short", "m", {{"gpu", 2}}},
                {"last", "m", {{"cpu", 6}}},
                {"long", "m", {{"gpu", 10}}}};
  app.edges = {{0, 1}, {1, 2}};
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 1, 0, -1}};
  const auto policy = solve(app, platform, counted(4000));
  ASSERT_TRUE(policy.has_value());
  EXPECT_EQ(policy->latency_us, 13);
  EXPECT_TRUE(policy->optimal);
}

TEST(Exact, AnExhaustedProofEndsBeforeItsTime) {
  // Idling on purpose may pay where preemption costs; such leaves stay open. The proof must return
  // from them, with no limit at all, instead of going over them again.
  test::Shape shape;
  shape.max_preempt = 6;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    test::Dice dice(40'000 + seed);
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    const auto problem = Problem::create(app, platform);
    ASSERT_TRUE(problem.has_value());
    const Time best = test::brute_force(*problem).makespan;
    std::atomic<Time> incumbent{best};
    ProofControl control;
    control.incumbent = &incumbent;
    EXPECT_LE(prove_bound(*problem, control), best) << seed;
  }
}

TEST(Exact, QuickBoundCountsLoadBetweenTheLeastHeadAndTail) {
  // One gpu, three XNodes of 10 that can only run there, between a fork and a join on the cpu.
  AppSpec app;
  app.name = "fork";
  app.xnodes = {{"fork", "m", {{"cpu", 5}}},
                {"a", "m", {{"gpu", 10}}},
                {"b", "m", {{"gpu", 10}}},
                {"c", "m", {{"gpu", 10}}},
                {"join", "m", {{"cpu", 7}}}};
  app.edges = {{0, 1}, {0, 2}, {0, 3}, {1, 4}, {2, 4}, {3, 4}};
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 0, 0, -1}};
  const auto problem = Problem::create(app, platform);
  ASSERT_TRUE(problem.has_value());
  EXPECT_EQ(critical_path_bound(*problem), 22);
  EXPECT_EQ(load_bound(*problem), 42);
  EXPECT_EQ(quick_bound(*problem), 42);
}

}  // namespace
}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// What the search promises.
#include "solver/search.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/order.h"
#include "solver/ordered.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "naive_simulator.h"
#include "problem_random.h"
#include "reference/valid_plan.h"

namespace xauto::solver {
namespace {

TEST(Search, AnOrderedSolutionIsTheSameWhereEachWaitsForTheOneBefore) {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    test::Dice dice(600 + seed);
    Problem problem = test::random_problem(dice, 14);
    if (seed % 2 == 0) {
      std::fill(problem.preemptive.begin(), problem.preemptive.end(), 1);
      std::fill(problem.preempt.begin(), problem.preempt.end(), 0);
    }
    const Decision drawn = test::random_decision(dice, problem);
    OrderedEvaluator ordered(problem);
    ordered.reset(drawn.xpu, sequence_of(drawn.priority));
    const Solution solution{ordered.xpu(), ordered.sequence(), ordered.makespan(), true};
    const Solution waiting = as_waiting(solution);
    EXPECT_EQ(simulate(problem, to_decision(waiting)).makespan, solution.makespan);
    const Solution sorted = by_finish(problem, solution);
    EXPECT_EQ(simulate(problem, to_decision(sorted)).makespan, sorted.makespan);
    if (seed % 2 == 0) {
      EXPECT_LE(sorted.makespan, solution.makespan);  // docs/ilp.md, theorem
    }
  }
}

TEST(Search, IsNeverWorseThanHeft) {
  for (std::uint64_t seed = 0; seed < 30; ++seed) {
    test::Dice dice(300 + seed);
    test::Shape shape;
    shape.max_nodes = 20;
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    const Problem problem = Problem::create(app, platform).value();
    SolveOptions options;
    options.method = "search";
    options.max_evaluations = 1;
    options.time_limit_s = 1e9;
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value());
    EXPECT_LE(policy->latency_us, simulate(problem, heft(problem)).makespan);
  }
}

TEST(Search, BeatsHeftClearlyOnThePaperWorkload) {
  GenerateOptions shape;
  shape.nodes = 30;
  const Platform platform = Platform::builtin("small").value();
  double ratio = 0;
  constexpr int kCases = 6;
  for (int k = 0; k < kCases; ++k) {
    shape.seed = static_cast<std::uint64_t>(k + 1);
    const AppSpec app = generate(shape).value();
    const Problem problem = Problem::create(app, platform).value();
    SolveOptions options;
    options.method = "search";
    options.max_evaluations = 30'000;
    options.time_limit_s = 1e9;
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value());
    ratio += static_cast<double>(simulate(problem, heft(problem)).makespan) /
             static_cast<double>(policy->latency_us) / kCases;
  }
  EXPECT_GT(ratio, 1.03);
}

TEST(Auto, IsTheSameForTheSameSeedThreadsAndBudget) {
  GenerateOptions shape;
  shape.nodes = 25;
  const AppSpec app = generate(shape).value();
  const Platform platform = Platform::builtin("small").value();
  for (const int threads : {1, 2, 3}) {
    SolveOptions options;
    options.threads = threads;
    options.max_evaluations = 20'000;
    options.time_limit_s = 1e9;
    auto first = solve(app, platform, options);
    auto second = solve(app, platform, options);
    ASSERT_TRUE(first.has_value() && second.has_value());
    first->solve_us = second->solve_us = 0;
    EXPECT_EQ(*first, *second) << threads << " threads";
  }
}

TEST(Solve, StopsAtOnceWhenToldAndStillAnswers) {
  GenerateOptions shape;
  shape.nodes = 40;
  const AppSpec app = generate(shape).value();
  const Platform platform = Platform::builtin("small").value();
  const std::atomic<bool> stop{true};
  SolveOptions options;
  options.time_limit_s = 1e9;
  options.stop = &stop;
  const auto policy = solve(app, platform, options);
  ASSERT_TRUE(policy.has_value());
  EXPECT_TRUE(reference::validate_plan(*policy, app, platform).has_value());
}

TEST(Solve, RefusesAnUnknownMethodByName) {
  GenerateOptions shape;
  const AppSpec app = generate(shape).value();
  SolveOptions options;
  options.method = "magic";
  const auto policy = solve(app, Platform::builtin("small").value(), options);
  ASSERT_FALSE(policy.has_value());
  EXPECT_EQ(policy.error().code, ErrorCode::kInvalid);
  EXPECT_NE(policy.error().what.find("magic"), std::string::npos);
}

}  // namespace
}  // namespace xauto::solver

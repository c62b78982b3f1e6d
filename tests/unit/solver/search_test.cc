// SPDX-License-Identifier: Apache-2.0
// The incremental evaluators against the simulators, and what the search promises.
#include "solver/search.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "solver/certify.h"
#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/ordered.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "naive_simulator.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

Problem random_problem(test::Dice& dice, int max_nodes) {
  test::Shape shape;
  shape.max_nodes = max_nodes;
  shape.edge_percent = 15;
  const Platform platform = test::random_platform(dice, shape);
  return Problem::create(test::random_app(dice, shape, platform), platform).value();
}

int any_xpu(test::Dice& dice, const Problem& problem, int xnode) {
  while (true) {
    const int xpu = dice.roll(0, problem.num_xpus - 1);
    if (problem.wcet_on(xnode, xpu) != kCannotRun) return xpu;
  }
}

template <class Eval>
void edit(test::Dice& dice, const Problem& problem, Eval& evaluator) {
  for (int edits = dice.roll(1, 3); edits > 0; --edits) {
    const int i = dice.roll(0, problem.num_xnodes - 1);
    if (dice.chance(50))
      evaluator.assign(i, any_xpu(dice, problem, i));
    else
      evaluator.reposition(i, dice.roll(0, problem.num_xnodes - 1));
  }
}

TEST(Evaluator, AgreesWithTheNaiveSimulatorAfterEveryEdit) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(seed);
    const Problem problem = random_problem(dice, 18);
    const Decision start = test::random_decision(dice, problem);
    Evaluator evaluator(problem);
    evaluator.reset(start.xpu, sequence_of(start.priority));
    for (int k = 0; k < 60; ++k) {
      edit(dice, problem, evaluator);
      const auto naive = test::naive_simulate(
          problem, to_decision({evaluator.xpu(), evaluator.sequence(), 0, false}));
      ASSERT_EQ(evaluator.evaluate(kNever), naive.makespan) << "seed " << seed << " step " << k;
      // Exactly at the limit means rejected.
      ASSERT_EQ(evaluator.evaluate(naive.makespan), kNever);
      ASSERT_EQ(evaluator.evaluate(naive.makespan + 1), naive.makespan);
      if (dice.chance(40)) {
        evaluator.commit();
        ASSERT_EQ(evaluator.makespan(), naive.makespan);
        for (int i = 0; i < problem.num_xnodes; ++i) {
          ASSERT_EQ(evaluator.start(i), naive.start[static_cast<std::size_t>(i)]);
          ASSERT_EQ(evaluator.finish(i), naive.finish[static_cast<std::size_t>(i)]);
        }
      } else {
        const Time before = evaluator.makespan();
        evaluator.rollback();
        ASSERT_EQ(evaluator.evaluate(kNever), before);
      }
    }
  }
}

TEST(Evaluator, AgreesWithTheNaiveSimulatorWhereXNodesWait) {
  int hangs = 0, waits = 0;
  for (std::uint64_t seed = 0; seed < 80; ++seed) {
    test::Dice dice(300 + seed);
    const Problem problem = random_problem(dice, 14);
    const Decision start = test::random_decision(dice, problem);
    Evaluator evaluator(problem);
    evaluator.reset(start.xpu, sequence_of(start.priority));
    for (int k = 0; k < 60; ++k) {
      if (dice.chance(50)) edit(dice, problem, evaluator);
      for (int edits = dice.roll(0, 3); edits > 0; --edits)
        evaluator.wait_for(dice.roll(0, problem.num_xnodes - 1),
                           dice.roll(-1, problem.num_xnodes - 1));
      Decision decision = to_decision({evaluator.xpu(), evaluator.sequence()});
      for (int v = 0; v < problem.num_xnodes; ++v) {
        const auto i = static_cast<std::size_t>(v);
        const int u = evaluator.waits_for()[i];
        if (u >= 0 && decision.xpu[static_cast<std::size_t>(u)] == decision.xpu[i])
          decision.order.emplace_back(u, v);
      }
      const auto naive = test::naive_simulate(problem, decision);
      if (std::any_of(naive.finish.begin(), naive.finish.end(), [](Time t) { return t < 0; })) {
        ++hangs;
        ASSERT_EQ(evaluator.evaluate(kNever), kNever) << "seed " << seed << " step " << k;
        evaluator.rollback();
        continue;
      }
      waits += !decision.order.empty();
      ASSERT_EQ(evaluator.evaluate(kNever), naive.makespan) << "seed " << seed << " step " << k;
      ASSERT_EQ(evaluator.evaluate(naive.makespan), kNever);
      if (dice.chance(40)) {
        evaluator.rollback();
        continue;
      }
      evaluator.commit();
      ASSERT_EQ(evaluator.makespan(), naive.makespan) << "seed " << seed << " step " << k;
      for (int i = 0; i < problem.num_xnodes; ++i) {
        ASSERT_EQ(evaluator.start(i), naive.start[static_cast<std::size_t>(i)]);
        ASSERT_EQ(evaluator.finish(i), naive.finish[static_cast<std::size_t>(i)]);
      }
    }
  }
  EXPECT_GT(hangs, 100);
  EXPECT_GT(waits, 500);
}

TEST(Search, AnOrderedSolutionIsTheSameWhereEachWaitsForTheOneBefore) {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    test::Dice dice(600 + seed);
    Problem problem = random_problem(dice, 14);
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

TEST(OrderedEvaluator, AgreesWithTheSimulatorUnderItsOrderPairs) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(100 + seed);
    const Problem problem = random_problem(dice, 18);
    const Decision start = test::random_decision(dice, problem);
    OrderedEvaluator evaluator(problem);
    evaluator.reset(start.xpu, sequence_of(start.priority));
    for (int k = 0; k < 40; ++k) {
      edit(dice, problem, evaluator);
      const Solution candidate{evaluator.xpu(), evaluator.sequence(), 0, true};
      Decision decision = to_decision(candidate);
      decision.order = order_pairs(problem, candidate);
      const Time expected = simulate(problem, decision).makespan;
      ASSERT_EQ(evaluator.evaluate(kNever), expected) << "seed " << seed << " step " << k;
      ASSERT_EQ(evaluator.evaluate(expected), kNever);
      if (dice.chance(40)) {
        evaluator.commit();
        ASSERT_EQ(evaluator.makespan(), expected);
      } else {
        evaluator.rollback();
      }
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
    first->solve_ms = second->solve_ms = 0;
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
  EXPECT_TRUE(validate(*policy, app, platform).has_value());
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

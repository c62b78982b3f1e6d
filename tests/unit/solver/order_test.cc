// SPDX-License-Identifier: Apache-2.0
// Run-time order, attacked: random and cornered execution times must never take longer than WCETs.
#include "solver/order.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "solver/ordered.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "problem_random.h"

namespace xauto::solver {
namespace {

/// The longest of `count` executions: uniform, all-or-nothing, and mostly full times, in turn.
Time longest_execution(test::Dice& dice, const Problem& problem, const Decision& decision,
                       int count) {
  std::vector<Time> actual(static_cast<std::size_t>(problem.num_xnodes));
  Time longest = 0;
  for (int k = 0; k < count; ++k) {
    for (int i = 0; i < problem.num_xnodes; ++i) {
      const auto wcet =
          static_cast<int>(problem.wcet_on(i, decision.xpu[static_cast<std::size_t>(i)]));
      int time = wcet;
      if (k % 3 == 0) time = dice.roll(0, wcet);
      if (k % 3 == 1) time = dice.chance(50) ? wcet : 0;
      if (k % 3 == 2) time = dice.chance(85) ? wcet : dice.roll(0, wcet);
      actual[static_cast<std::size_t>(i)] = time;
    }
    SimulateOptions options;
    options.actual = actual;
    longest = std::max(longest, simulate(problem, decision, options).makespan);
  }
  return longest;
}

struct Case {
  Platform platform;
  AppSpec app;
  Problem problem;
};

Case random_case(test::Dice& dice, int max_nodes) {
  test::Shape shape;
  shape.max_nodes = max_nodes;
  shape.edge_percent = 15;
  Case c;
  c.platform = test::random_platform(dice, shape);
  c.app = test::random_app(dice, shape, c.platform);
  c.problem = Problem::create(c.app, c.platform).value();
  return c;
}

/// Assignment and order at random, in the sequence that they give.
Solution ordered_at_random(test::Dice& dice, const Problem& problem) {
  const Decision random = test::random_decision(dice, problem);
  OrderedEvaluator evaluator(problem);
  evaluator.reset(random.xpu, sequence_of(random.priority));
  return {evaluator.xpu(), evaluator.sequence(), evaluator.makespan(), true};
}

TEST(Order, AnOrderedScheduleIsItsOwnWorstCase) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(1500 + seed);
    const Case c = random_case(dice, 16);
    const Solution solution = ordered_at_random(dice, c.problem);
    Decision decision = to_decision(solution);
    decision.order = order_pairs(c.problem, solution);
    ASSERT_EQ(simulate(c.problem, decision).makespan, solution.makespan) << "seed " << seed;
    ASSERT_LE(longest_execution(dice, c.problem, decision, 150), solution.makespan)
        << "seed " << seed;
  }
}

TEST(Order, OrderPairsAreMinimal) {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    test::Dice dice(3000 + seed);
    const Case c = random_case(dice, 14);
    const auto pairs = order_pairs(c.problem, ordered_at_random(dice, c.problem));
    // Without any one of them, its two XNodes are no longer ordered.
    for (const auto& left_out : pairs) {
      std::vector<std::vector<int>> succ = c.problem.succ;
      for (const auto& [u, v] : pairs)
        if (std::pair(u, v) != left_out) succ[static_cast<std::size_t>(u)].push_back(v);
      std::vector<int> queue = {left_out.first};
      for (std::size_t k = 0; k < queue.size(); ++k)
        for (int s : succ[static_cast<std::size_t>(queue[k])])
          if (std::find(queue.begin(), queue.end(), s) == queue.end()) queue.push_back(s);
      EXPECT_EQ(std::find(queue.begin(), queue.end(), left_out.second), queue.end());
    }
  }
}

/// Else the tests above would prove nothing.
TEST(Order, WithoutItAShorterJobMayLengthenTheWhole) {
  int anomalies = 0;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(4000 + seed);
    const Case c = random_case(dice, 14);
    const Decision decision = test::random_decision(dice, c.problem);
    const Time at_wcet = simulate(c.problem, decision).makespan;
    anomalies += longest_execution(dice, c.problem, decision, 200) > at_wcet ? 1 : 0;
  }
  EXPECT_GT(anomalies, 0);
}

/// docs/ilp.md, consequence 3, where preemption is free.
TEST(Order, PrioritiesByFinishHaveNoAnomalies) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(80'000 + seed);
    Case c = random_case(dice, 16);
    c.problem.preemptive.assign(c.problem.preemptive.size(), 1);
    c.problem.preempt.assign(c.problem.preempt.size(), 0);
    c.problem.levels.assign(c.problem.levels.size(), 0);
    Decision decision = test::random_decision(dice, c.problem);
    const Simulation drawn = simulate(c.problem, decision);
    decision.priority = priorities_by_key(drawn.finish);
    const Time at_wcet = simulate(c.problem, decision).makespan;
    ASSERT_LE(at_wcet, drawn.makespan) << "seed " << seed;
    ASSERT_LE(longest_execution(dice, c.problem, decision, 400), drawn.makespan) << "seed " << seed;
  }
}

TEST(Order, WhatIsAskedToBeOrderedIs) {
  test::Dice dice(77);
  const Case c = random_case(dice, 14);
  SolveOptions options;
  options.max_evaluations = 20'000;
  options.time_limit_s = 1e9;
  options.ordered_only = true;
  const auto policy = solve(c.app, c.platform, options);
  ASSERT_TRUE(policy.has_value());
  Decision decision;
  for (const PriorityPlacement& placed : policy->placements) {
    decision.xpu.push_back(placed.xpu);
    decision.priority.push_back(placed.priority);
  }
  decision.order = policy->order;
  EXPECT_LE(longest_execution(dice, c.problem, decision, 1000), policy->latency_us);
}

TEST(Order, TheOrderOfAnUndisturbedXpuChangesNothingAtWcet) {
  int added = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    test::Dice dice(95'000 + seed);
    const Case c = random_case(dice, 14);
    Decision decision = test::random_decision(dice, c.problem);
    test::add_random_order(dice, c.problem, decision, 10);
    const Decision ordered = order_undisturbed(c.problem, decision);
    ASSERT_EQ(simulate(c.problem, ordered).finish, simulate(c.problem, decision).finish) << seed;
    added += ordered.order.size() > decision.order.size();
  }
  EXPECT_GT(added, 100);
}

}  // namespace
}  // namespace xauto::solver

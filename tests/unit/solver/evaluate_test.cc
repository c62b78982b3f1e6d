// SPDX-License-Identifier: Apache-2.0
// The incremental evaluators against the simulators, after every edit.
#include "solver/evaluate.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "solver/order.h"
#include "solver/ordered.h"
#include "solver/search.h"
#include "solver/simulate.h"

#include "naive_simulator.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

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
    const Problem problem = test::random_problem(dice, 18);
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
    const Problem problem = test::random_problem(dice, 14);
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

TEST(OrderedEvaluator, AgreesWithTheSimulatorUnderItsOrderPairs) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(100 + seed);
    const Problem problem = test::random_problem(dice, 18);
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

/// What annealing starts its moves from.
TEST(Evaluator, TheCriticalChainExplainsTheMakespan) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(900 + seed);
    Problem problem = test::random_problem(dice, 14);
    std::fill(problem.preemptive.begin(), problem.preemptive.end(), 0);
    const Decision drawn = test::random_decision(dice, problem);
    Evaluator evaluator(problem);
    evaluator.reset(drawn.xpu, sequence_of(drawn.priority));
    std::vector<int> chain;
    evaluator.critical_chain(chain);
    ASSERT_FALSE(chain.empty());
    // Nothing preempts here: each began the moment that the next one in the chain ended.
    EXPECT_EQ(evaluator.finish(chain.front()), evaluator.makespan());
    for (std::size_t k = 0; k + 1 < chain.size(); ++k)
      EXPECT_EQ(evaluator.start(chain[k]), evaluator.finish(chain[k + 1])) << "seed " << seed;
    EXPECT_EQ(evaluator.start(chain.back()), 0);
  }
}

}  // namespace
}  // namespace xauto::solver

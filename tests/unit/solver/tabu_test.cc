// SPDX-License-Identifier: Apache-2.0
// The graph of an ordered schedule against the evaluator, and what the tabu search promises.
#include "solver/tabu.h"

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/disjunctive.h"
#include "solver/order.h"
#include "solver/ordered.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "job_shop.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

TEST(DisjunctiveGraph, HasTheMakespanOfTheOrderedEvaluatorAfterAnyMove) {
  int moved = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    test::Dice dice(7000 + seed);
    const Problem problem = test::random_problem(dice, 16);
    const Decision drawn = test::random_decision(dice, problem);
    DisjunctiveGraph graph(problem);
    graph.reset(drawn.xpu, sequence_of(drawn.priority));
    OrderedEvaluator evaluator(problem);
    for (int step = 0; step < 20; ++step) {
      evaluator.reset(graph.xpu(), graph.sequence());
      ASSERT_EQ(evaluator.makespan(), graph.makespan());
      for (int i = 0; i < problem.num_xnodes; ++i)
        EXPECT_LE(graph.head(i) + graph.work(i) + graph.tail(i), graph.makespan());
      const int i = dice.roll(0, problem.num_xnodes - 1), own = graph.xpu()[at(i)];
      const int other = dice.roll(0, problem.num_xpus - 1);
      if (other != own && problem.wcet_on(i, other) != kCannotRun) {
        const auto places = graph.places(i, other);
        if (places.first > places.last) continue;
        const auto place = static_cast<std::size_t>(
            dice.roll(static_cast<int>(places.first), static_cast<int>(places.last)));
        const Time estimate = graph.after_insertion(i, other, place);
        graph.move(i, other, place);
        ASSERT_TRUE(graph.update()) << "a place that closes a cycle";
        // What leaves its XPU delays nobody there any more.
        EXPECT_LE(graph.head(i) + graph.work(i) + graph.tail(i), estimate);
        ++moved;
      } else if (other == own && graph.on(own).size() > 1) {
        const std::size_t from = graph.place(i);
        const auto to =
            static_cast<std::size_t>(dice.roll(0, static_cast<int>(graph.on(own).size()) - 1));
        if (from == to) continue;
        if (from < to ? !graph.may_follow(own, from, to) : !graph.may_precede(own, from, to))
          continue;
        graph.move(i, own, to);
        ASSERT_TRUE(graph.update()) << "a shift that closes a cycle";
        ++moved;
      }
    }
  }
  EXPECT_GT(moved, 500);
}

TEST(DisjunctiveGraph, EstimatesAShiftOfNeighboursAsThePathThroughThem) {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    test::Dice dice(7500 + seed);
    const Problem problem = test::random_problem(dice, 12);
    const Decision drawn = test::random_decision(dice, problem);
    DisjunctiveGraph graph(problem);
    graph.reset(drawn.xpu, sequence_of(drawn.priority));
    for (int x = 0; x < problem.num_xpus; ++x) {
      if (graph.on(x).size() < 2 || !graph.may_follow(x, 0, 1)) continue;
      const int first = graph.on(x)[0], second = graph.on(x)[1];
      const Time estimate = graph.after_shift(x, 0, 1);
      EXPECT_EQ(estimate, graph.after_shift(x, 1, 0));
      graph.move(first, x, 1);
      ASSERT_TRUE(graph.update());
      const auto through = [&](int i) { return graph.head(i) + graph.left(i); };
      EXPECT_EQ(estimate, std::max(through(first), through(second)));
      break;
    }
  }
}

TEST(TabuSearch, SaysWhatItsScheduleTakesAndIsNeverWorseThanItsStart) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(7800 + seed);
    const Problem problem = test::random_problem(dice, 14);
    const Decision drawn = test::random_decision(dice, problem);
    OrderedEvaluator evaluator(problem);
    evaluator.reset(drawn.xpu, sequence_of(drawn.priority));
    const Solution start{evaluator.xpu(), evaluator.sequence(), evaluator.makespan(), true, {}};
    StopWhen when;
    when.max_evaluations = 1000;
    TabuSearch search(problem, seed);
    const Solution found = search.run(start, when, {});
    EXPECT_LE(found.makespan, start.makespan);
    Decision decision = to_decision(found);
    decision.order = order_pairs(problem, found);
    EXPECT_EQ(simulate(problem, decision).makespan, found.makespan);
    EXPECT_LE(search.run(start, when, {}).makespan, found.makespan);
  }
}

TEST(TabuSearch, FindsTheOptimumOfAJobShop) {
  const test::JobShop shop = test::ft06();
  const Problem problem = Problem::create(shop.app, shop.platform).value();
  StopWhen when;
  when.max_evaluations = 100'000;
  Solution start = constructive_solutions(problem).front();
  EXPECT_GT(start.makespan, 55);
  start.makespan = kNever;
  EXPECT_EQ(TabuSearch(problem, 1).run(start, when, {}).makespan, 55);
}

}  // namespace
}  // namespace xauto::solver

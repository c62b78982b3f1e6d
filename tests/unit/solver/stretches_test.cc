// SPDX-License-Identifier: Apache-2.0
// What a stretch says of the whole schedule, and what the search over stretches promises.
#include "solver/stretches.h"

#include <algorithm>
#include <utility>

#include <gtest/gtest.h>

#include "base/index.h"
#include "solver/order.h"
#include "solver/simulate.h"

#include "problem_random.h"

namespace xauto::solver {
namespace {

Solution random_ordered(test::Dice& dice, const Problem& problem) {
  const Decision drawn = test::random_decision(dice, problem);
  OrderedEvaluator evaluator(problem);
  evaluator.reset(drawn.xpu, sequence_of(drawn.priority));
  return {evaluator.xpu(), evaluator.sequence(), evaluator.makespan(), true, {}};
}

Time makespan_of(const Problem& problem, const Solution& solution) {
  OrderedEvaluator evaluator(problem);
  evaluator.reset(solution.xpu, solution.sequence);
  return evaluator.makespan();
}

/// All paths meet the stretch, or are as long as if it took no time.
TEST(Stretches, ThePartHasTheMakespanOfTheWholeWhateverIsDoneInIt) {
  int by_part = 0, beside = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    test::Dice dice(9100 + seed);
    const Problem problem = test::random_problem(dice, 18);
    Solution whole = random_ordered(dice, problem);
    const Time claimed = whole.makespan;
    DisjunctiveGraph graph(problem);
    follow(graph, whole);
    ASSERT_EQ(whole.makespan, claimed);
    const int length = dice.roll(1, problem.num_xnodes);
    const auto first = at(dice.roll(0, problem.num_xnodes - length));
    const Stretch stretch = stretch_of(problem, graph, whole, first, at(length));
    Problem empty = problem;
    for (int i : stretch.members)
      for (int t = 0; t < problem.num_types; ++t)
        if (Time& wcet = empty.wcet_flat[at(i * problem.num_types + t)]; wcet != kCannotRun)
          wcet = 0;
    OrderedEvaluator part(stretch.part, &stretch.around);
    part.reset(stretch.now.xpu, stretch.now.sequence);
    for (int step = 0; step < 20; ++step) {
      const int i = dice.roll(0, length - 1), x = dice.roll(0, problem.num_xpus - 1);
      if (stretch.part.wcet_on(i, x) != kCannotRun) part.assign(i, x);
      part.reposition(i, dice.roll(0, length - 1));
      const Time tried = part.evaluate(kNever);
      part.commit();
      ASSERT_EQ(tried, part.makespan());
      Solution merged = whole;
      for (std::size_t k = 0; k < at(length); ++k) {
        merged.xpu[at(stretch.members[k])] = part.xpu()[k];
        merged.sequence[first + k] = stretch.members[at(part.sequence()[k])];
      }
      const Time through = part.makespan() + stretch.outside, around = makespan_of(empty, merged);
      ASSERT_EQ(makespan_of(problem, merged), std::max(through, around)) << "seed " << seed;
      ++(through >= around ? by_part : beside);
      std::vector<int> chain;
      part.critical_chain(chain);
      ASSERT_FALSE(chain.empty());
    }
  }
  EXPECT_GT(by_part, 4000);
  EXPECT_GT(beside, 40);
}

TEST(Stretches, SaysWhatItsScheduleTakesAndIsNeverWorseThanItsStart) {
  int better = 0;
  for (std::uint64_t seed = 0; seed < 25; ++seed) {
    test::Dice dice(9600 + seed);
    const Problem problem = test::random_problem(dice, 40);
    const Solution start = random_ordered(dice, problem);
    StopWhen when;
    when.max_evaluations = 5000;
    Time last = kNever;
    SearchCallbacks callbacks;
    callbacks.on_better = [&](const Solution& solution) {
      EXPECT_LT(solution.makespan, last);
      last = solution.makespan;
    };
    std::int64_t evaluations = 0;
    callbacks.on_evaluations = [&](std::int64_t count) { evaluations += count; };
    const Solution found = anneal_stretches(problem, start, seed, when, callbacks);
    EXPECT_EQ(last, found.makespan);
    EXPECT_GE(evaluations, when.max_evaluations);
    EXPECT_LE(evaluations, when.max_evaluations + 100);
    EXPECT_LE(found.makespan, start.makespan);
    better += found.makespan < start.makespan ? 1 : 0;
    Decision decision = to_decision(found);
    decision.order = order_pairs(problem, found);
    EXPECT_EQ(simulate(problem, decision).makespan, found.makespan);
    const Solution again = anneal_stretches(problem, start, seed, when);
    EXPECT_EQ(again.xpu, found.xpu);
    EXPECT_EQ(again.sequence, found.sequence);
  }
  EXPECT_GT(better, 20);
}

}  // namespace
}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
#include "solver/heft.h"

#include <gtest/gtest.h>

#include "solver/simulate.h"

#include "naive_simulator.h"
#include "problem_random.h"

namespace xauto::solver::test {
namespace {

AppSpec chain_and_single() {
  AppSpec app;
  app.name = "t";
  app.xnodes = {
      {"a", "A", {{"cpu", 10}}}, {"b", "B", {{"cpu", 40}, {"gpu", 10}}}, {"c", "C", {{"gpu", 10}}}};
  app.edges = {{0, 1}};
  return app;
}

Platform cpu_gpu() {
  return {"two", {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 0, 0, -1}}};
}

TEST(Heft, PutsALessUrgentXNodeIntoTheGapBeforeAMoreUrgentOne) {
  // b (rank 25 behind a) is planned on the GPU from 10 to 20; c fits before it.
  const Problem p = *Problem::create(chain_and_single(), cpu_gpu());
  const Decision d = heft(p);
  EXPECT_EQ(d.xpu, (std::vector<int>{0, 1, 1}));
  EXPECT_GT(d.priority[2], d.priority[1]);
  EXPECT_EQ(simulate(p, d).makespan, 20);
}

TEST(Heft, DecisionsAreLegalAndNeverLongerThanEverythingInARow) {
  Dice dice(1);
  for (int round = 0; round < 300; ++round) {
    const Platform platform = random_platform(dice, {});
    const AppSpec app = random_app(dice, {}, platform);
    const Problem p = *Problem::create(app, platform);
    for (const Decision& d : {heft(p), local(p)}) {
      Time all = 0, least_end = 0;
      for (int i = 0; i < p.num_xnodes; ++i) {
        ASSERT_NE(p.wcet_on(i, d.xpu[static_cast<std::size_t>(i)]), kCannotRun);
        all += p.wcet_on(i, d.xpu[static_cast<std::size_t>(i)]) + 4;  // 4: the dearest preemption
        least_end = std::max(least_end, p.wcet_on(i, d.xpu[static_cast<std::size_t>(i)]));
      }
      const Time makespan = simulate(p, d).makespan;
      ASSERT_LE(makespan, all);
      ASSERT_GE(makespan, least_end);
      ASSERT_EQ(makespan, naive_simulate(p, d).makespan);
    }
  }
}

TEST(Local, EveryXNodeTakesItsFastestTypeAndTiesTheFirstOfThePlatform) {
  AppSpec app = chain_and_single();
  app.xnodes[2].wcet_us = {{"cpu", 10}, {"gpu", 10}};
  const Problem p = *Problem::create(app, cpu_gpu());
  EXPECT_EQ(local(p).xpu, (std::vector<int>{0, 1, 0}));
}

TEST(Local, SpreadsOverTheInstancesOfAType) {
  AppSpec app;
  app.name = "t";
  for (int i = 0; i < 4; ++i) app.xnodes.push_back({numbered("x", i), "m", {{"cpu", 10}}});
  const Problem p = *Problem::create(app, *Platform::builtin("small"));
  EXPECT_EQ(simulate(p, local(p)).makespan, 10);
}

}  // namespace
}  // namespace xauto::solver::test

// SPDX-License-Identifier: Apache-2.0
// What bench_keys compares the solver with: does it do what its name says?
#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/one_release.h"

#include "bench/keys/annealer.h"
#include "bench/keys/measure.h"
#include "bench/keys/rivals.h"

namespace xauto::bench {
namespace {

/// A long job of 100 ms beside a short one of 10 ms on the one CPU; y may also run on the GPU.
RatedCase small(std::int64_t preempt_us = 0) {
  RatedCase made;
  made.name = "small";
  made.app.name = "small";
  made.app.sources = {{"slow", {100'000}}, {"fast", {10'000}}};
  made.app.xnodes = {{"x", "x", {{"cpu", 40'000}}, {0}},
                     {"y", "y", {{"cpu", 2'000}, {"gpu", 3'000}}, {1}}};
  made.app.modules = {{"x"}, {"y"}};
  made.app.chains = {{"x", 0, 0, 90'000}, {"y", 1, 1, 8'000}};
  made.platform = {"p", {{"c0", "cpu", true, preempt_us}, {"g0", "gpu"}}};
  EXPECT_TRUE(validate(made.app));
  return made;
}

Policy on_the_cpu(const RatedCase& made) {
  Policy policy{made.app.name, made.app.hash(), "p", "test", {{0, {60'000}}, {0, {2'000}}}, {}, 0};
  policy.chains = {{"x", 60'000, 40'000, false}, {"y", 2'000, 2'000, true}};
  return policy;
}

/// The plan of one release knows no periods: of two apps that differ in those alone one asks for more than the plan.
TEST(KeysRivals, FixedPrioritiesAreByPeriodTheShortestFirst) {
  for (const bool x_is_fast : {false, true}) {
    RatedCase made = small();
    if (x_is_fast) std::swap(made.app.sources[0].period, made.app.sources[1].period);
    solver::SolveOptions options;
    options.max_evaluations = 100;
    const auto policy = solver::keys::fixed_priorities(made.app, made.platform, options);
    ASSERT_TRUE(policy) << policy.error().to_string();
    EXPECT_TRUE(policy->by_priority());
    EXPECT_FALSE(policy->certified);
    EXPECT_TRUE(policy->order.empty());
    EXPECT_EQ(policy->placements[0].priority > policy->placements[1].priority, x_is_fast);
  }
}

TEST(KeysRivals, EachIsWhatItsNameSays) {
  const RatedCase made = small();
  const Policy ours = on_the_cpu(made);
  ASSERT_TRUE(solver::keys::check(made.app, made.platform, ours));
  const auto list = rivals(made.app, made.platform, ours);
  ASSERT_TRUE(list) << list.error().to_string();
  ASSERT_EQ(list->size(), 4u);
  EXPECT_EQ((*list)[1].name, "rm");
  EXPECT_LT((*list)[1].rank[1], (*list)[1].rank[0]);
  EXPECT_NEAR((*list)[1].load, 0.6, 1e-9);
  EXPECT_EQ((*list)[3].name, "fastest");
  EXPECT_EQ((*list)[3].xpu, (std::vector<int>{0, 0}));
  const Plays plays{2, 1000, 1};
  // First come: y waits for x, 40 ms. By its rate it waits for nobody.
  const auto fcfs = observe(made.app, made.platform, ours, (*list)[2], plays);
  const auto rm = observe(made.app, made.platform, ours, (*list)[1], plays);
  const auto own = observe(made.app, made.platform, ours, plays);
  ASSERT_TRUE(fcfs && rm && own);
  EXPECT_GE(fcfs->longest_us[1], 40'000);
  EXPECT_EQ(rm->longest_us[1], 2'000);
  EXPECT_LE(own->longest_us[1], 2'000);
  EXPECT_EQ(own->late, 0);
  EXPECT_FALSE(rm->backlog);
}

TEST(KeysRivals, WhatCannotKeepUpGrows) {
  RatedCase made = small();
  Policy ours = on_the_cpu(made);
  Rival rival{"all", {0, 0}, {1, 0}, 0};
  const Plays plays{1, 2000, 1};
  const auto light = observe(made.app, made.platform, ours, rival, plays);
  ASSERT_TRUE(light) << light.error().to_string();
  EXPECT_FALSE(light->backlog);
  made.app.xnodes[0].wcet_us["cpu"] = 90'000;
  ours.app_hash = made.app.hash();
  ours.placements[0].key_us = {95'000};
  ours.chains[0] = {"x", 95'000, 90'000, false};
  const auto heavy = observe(made.app, made.platform, ours, rival, {1, 20'000, 1});
  ASSERT_TRUE(heavy) << heavy.error().to_string();
  EXPECT_TRUE(heavy->backlog);
}

TEST(KeysAnnealer, ItsPolicyIsOneThatTheCheckDerives) {
  for (const std::int64_t preempt_us : {0, 300}) {
    const RatedCase made = small(preempt_us);
    const Annealed found = anneal(made.app, made.platform, 0.02, 1);
    ASSERT_TRUE(found.policy);
    EXPECT_GE(found.evaluations, 1);
    const auto report = solver::keys::check(made.app, made.platform, *found.policy);
    ASSERT_TRUE(report) << report.error().to_string();
    for (std::size_t c = 0; c < report->chains.size(); ++c)
      EXPECT_EQ(report->chains[c].derived_us, found.policy->chains[c].worst_case_us);
    EXPECT_LE(objective_of(made.app, *found.policy), 1);
  }
}

TEST(KeysAnnealer, SeveralClocksAndFlightsHoldToo) {
  int found = 0;
  for (double limit_s = 0.2; found == 0 && limit_s < 20; limit_s *= 4)  // a sanitizer is slow
    for (const RatedCase& made :
         {make_case(Kind::kClocks, 2, 40), make_case(Kind::kPipelined, 3, 40),
          make_case(Kind::kMixed, 1, 40)}) {
      const Annealed answer = anneal(made.app, made.platform, limit_s, 1);
      if (!answer.policy) continue;
      ++found;
      const auto report = solver::keys::check(made.app, made.platform, *answer.policy);
      EXPECT_TRUE(report) << made.name << ": " << report.error().to_string();
    }
  EXPECT_GE(found, 1);
}

TEST(KeysAnnealer, ObjectiveIsTheLatestChainOrElseTheSum) {
  AppSpec app = small().app;
  EXPECT_DOUBLE_EQ(objective_of(app, {45'000, 6'000}), 0.75);
  app.chains[0].deadline_us.reset();
  app.chains[1].deadline_us.reset();
  app.chains[1].weight = 3;
  EXPECT_DOUBLE_EQ(objective_of(app, {45'000, 6'000}), 63'000);
}

TEST(KeysMeasure, SaysWhatTheSolverFoundAndWhatItTook) {
  Asked asked;
  asked.time_limit_s = 0.3;
  asked.threads = 1;
  asked.annealer_s = 0.02;
  asked.plays = {2, 1000, 1};
  const auto m = measure(small(), asked);
  ASSERT_TRUE(m) << m.error().to_string();
  EXPECT_EQ(m->outcome, "policy");
  EXPECT_GE(m->objective, m->bound);
  EXPECT_LE(m->ours_ratio, 1);
  EXPECT_EQ(m->late, 0);
  EXPECT_GT(m->memory_mib, 1);
  EXPECT_EQ(m->beside.size(), 4u);
  EXPECT_TRUE(m->annealed);
  RatedCase over = small();
  over.app.xnodes[0].wcet_us["cpu"] = 110'000;
  const auto refused = measure(over, asked);
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->outcome, "overload");
  EXPECT_TRUE(refused->beside.empty());
}

}  // namespace
}  // namespace xauto::bench

// SPDX-License-Identifier: Apache-2.0
// The entry to all methods: what every one of them owes its caller, and the method `ilp` through
// it.
#include "solver/solve.h"

#include <gtest/gtest.h>

#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/simulate.h"

#include "brute_force.h"
#include "problem_random.h"

namespace xauto::solver {
namespace {

AppSpec synthetic(int nodes, std::uint64_t seed) {
  GenerateOptions options;
  options.nodes = nodes;
  options.seed = seed;
  return *generate(options);
}

Time heft_latency(const AppSpec& app, const Platform& platform) {
  const Problem problem = *Problem::create(app, platform);
  return simulate(problem, heft(problem)).makespan;
}

TEST(Solve, IlpNeverAnswersWorseThanHeftNorBelowTheOptimum) {
  int proven = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    test::Dice dice(700 + seed);
    test::Shape shape;
    shape.max_nodes = 6;
    shape.max_cpus = 2;
    const Platform platform = test::random_platform(dice, shape);
    const AppSpec app = test::random_app(dice, shape, platform);
    SolveOptions options;
    options.method = "ilp";
    options.time_limit_s = 100;
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value()) << policy.error().to_string();
    const Time best = test::brute_force(*Problem::create(app, platform)).makespan;
    EXPECT_LE(policy->latency_us, heft_latency(app, platform)) << seed;
    EXPECT_GE(policy->latency_us, best) << seed;
    EXPECT_LE(policy->lower_bound_us, best) << seed;
    EXPECT_EQ(policy->method, "ilp");
    proven += policy->optimal;
  }
  EXPECT_GE(proven, 25);
}

TEST(Solve, PreemptiveXpusDoNotMakeTheAnswerWorse) {
  // Job shops, 10 jobs of 6 operations with 1 to 3 machines to choose from: what an order reaches
  // on machines that do not preempt stays legal on those that do. These were worse by 1 each.
  Time preemptive = 0, not_preemptive = 0;
  for (const std::uint64_t seed : {9002U, 9006U, 9009U}) {
    test::Dice dice(seed);
    AppSpec app;
    app.name = "job shop";
    for (int job = 0; job < 10; ++job)
      for (int operation = 0; operation < 6; ++operation) {
        const int i = static_cast<int>(app.xnodes.size());
        XNodeSpec xnode;
        xnode.name = test::numbered("x", i);
        xnode.module = "m";
        for (int choices = dice.roll(1, 3); choices > 0; --choices) {
          const int time = dice.roll(1, 6);
          xnode.wcet_us[test::numbered("m", dice.roll(1, 6))] = time;
        }
        app.xnodes.push_back(std::move(xnode));
        if (operation > 0) app.edges.emplace_back(i - 1, i);
      }
    for (const bool preempts : {false, true}) {
      Platform platform;
      platform.name = "six machines";
      for (int k = 1; k <= 6; ++k)
        platform.xpus.push_back({test::numbered("m", k) + "_0", test::numbered("m", k), preempts,
                                 preempts ? 3 : 0, 1, -1});
      SolveOptions options;
      options.method = "search";
      options.max_evaluations = 300'000;
      options.time_limit_s = 1e9;
      (preempts ? preemptive : not_preemptive) += solve(app, platform, options)->latency_us;
    }
  }
  EXPECT_LE(preemptive, not_preemptive);
}

TEST(Solve, IlpTakesTheCompactModelWhereThePapersIsTooLarge) {
  const Platform platform = *Platform::builtin("small");
  const AppSpec app = synthetic(30, 3);
  SolveOptions options;
  options.method = "ilp";
  options.time_limit_s = 20;
  const auto policy = solve(app, platform, options);
  ASSERT_TRUE(policy.has_value());
  SolveOptions search;
  search.max_evaluations = 20'000;
  const auto other = solve(app, platform, search);
  ASSERT_TRUE(other.has_value());
  EXPECT_LE(policy->lower_bound_us, other->latency_us);
  EXPECT_LE(policy->latency_us, heft_latency(app, platform));
  // The model knows more than a load and a critical path: far from nothing.
  EXPECT_GT(static_cast<double>(policy->lower_bound_us),
            0.8 * static_cast<double>(policy->latency_us));
}

TEST(Solve, EveryMethodAnswersWhenItIsStoppedBeforeItBegins) {
  const Platform platform = *Platform::builtin("small");
  const std::atomic<bool> stop{true};
  for (const int nodes : {12, 40})
    for (const char* method : {"auto", "search", "ilp", "heft", "local"}) {
      const AppSpec app = synthetic(nodes, 5);
      SolveOptions options;
      options.method = method;
      options.time_limit_s = 1000;
      options.stop = &stop;
      const auto policy = solve(app, platform, options);
      ASSERT_TRUE(policy.has_value()) << method;
      EXPECT_EQ(policy->placements.size(), app.xnodes.size());
      EXPECT_LE(policy->lower_bound_us, policy->latency_us) << method;
      ASSERT_TRUE(policy->worst_case_us.has_value());
      EXPECT_GE(*policy->worst_case_us, policy->latency_us) << method;
      if (std::string(method) != "local") {
        EXPECT_LE(policy->latency_us, heft_latency(app, platform)) << method;
      }
    }
}

TEST(Solve, TheFirstProgressIsAnAnswerNoWorseThanHeft) {
  const Platform platform = *Platform::builtin("large");
  for (const int nodes : {10, 40, 120}) {
    const AppSpec app = synthetic(nodes, 9);
    SolveOptions options;
    SolveReport report;
    std::vector<Progress> seen;
    options.max_evaluations = 2000;
    options.time_limit_s = 1e9;
    options.report = &report;
    options.on_progress = [&](const Progress& progress) { seen.push_back(progress); };
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value());
    ASSERT_FALSE(seen.empty());
    EXPECT_LE(seen.front().incumbent, heft_latency(app, platform));
    EXPECT_LE(report.first_latency_us, heft_latency(app, platform));
    EXPECT_GE(seen.front().incumbent, policy->latency_us);
    EXPECT_GT(report.first_answer_ms, 0);
  }
}

TEST(Solve, AnUnknownMethodIsNamed) {
  SolveOptions options;
  options.method = "magic";
  const auto policy = solve(synthetic(5, 1), *Platform::builtin("small"), options);
  ASSERT_FALSE(policy.has_value());
  EXPECT_NE(policy.error().to_string().find("magic"), std::string::npos);
}

}  // namespace
}  // namespace xauto::solver

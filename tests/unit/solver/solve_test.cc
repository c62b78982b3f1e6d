// SPDX-License-Identifier: Apache-2.0
// The entry to all methods: what every one of them owes its caller, and the method `ilp` through
// it.
#include "solver/solve.h"

#include <atomic>
#include <ctime>

#include <gtest/gtest.h>

#include "model/json.h"
#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/simulate.h"

#include "../cases.h"
#include "brute_force.h"
#include "problem_random.h"
#include "reference/verify.h"

namespace xauto::solver {
namespace {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr double kSlack = 12;
#else
constexpr double kSlack = 1.5;
#endif

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
  const int apps = xauto::test::cases(12, 40);
  int proven = 0;
  for (std::uint64_t seed = 0; seed < static_cast<std::uint64_t>(apps); ++seed) {
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
  EXPECT_GE(8 * proven, 5 * apps);
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

TEST(Solve, IlpIsForSixtyXNodes) {
  SolveOptions options;
  options.method = "ilp";
  const auto refused = solve(synthetic(61, 3), *Platform::builtin("small"), options);
  ASSERT_FALSE(refused.has_value());
  EXPECT_NE(refused.error().to_string().find("at most 60 XNodes"), std::string::npos);
}

// Its N = 15, seed 2 ended after 0.03 of 8 s at 100.29 ms where 93.32 is proven. Seed 3 of 20 has a model that is shorter
// than any policy, which pays for preemption.
TEST(Solve, IlpEndsBeforeItsLimitOnlyWithAProof) {
  const Platform platform = *Platform::builtin("small");
  for (const auto& [nodes, seed] : {std::pair(15, 2), std::pair(20, 3), std::pair(20, 1)}) {
    SolveOptions options;
    SolveReport report;
    options.method = "ilp";
    options.time_limit_s = 60;
    options.report = &report;
    const auto policy =
        solve(synthetic(nodes, static_cast<std::uint64_t>(seed)), platform, options);
    ASSERT_TRUE(policy.has_value());
    EXPECT_TRUE(policy->optimal) << nodes << " " << seed << ": " << policy->latency_us << ", "
                                 << report.proof;
    EXPECT_EQ(report.proof.find("the proof of method auto") != std::string::npos, seed != 1)
        << report.proof;
  }
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
    std::vector<Progress> seen;
    options.max_evaluations = 2000;
    options.time_limit_s = 1e9;
    options.on_progress = [&](const Progress& progress) { seen.push_back(progress); };
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value());
    ASSERT_FALSE(seen.empty());
    EXPECT_LE(seen.front().incumbent, heft_latency(app, platform));
    EXPECT_GE(seen.front().incumbent, policy->latency_us);
  }
}

/// Camera and lidar share one GPU; what lidar starts goes on for long.
TEST(Solve, WhatAPolicyFileCannotHoldIsRefusedBeforeItIsSolved) {
  const Platform platform = *Platform::builtin("small");
  AppSpec app;
  app.name = "long";
  const std::int64_t most = kMaxTimeUs - 2 * 275;  // a preemption of small's GPU each
  app.xnodes = {{"a", "A", {{"cpu", most / 2}}}, {"b", "B", {{"cpu", most / 2}}}};
  app.edges = {{0, 1}};
  SolveOptions options;
  options.time_limit_s = 1;
  for (const char* method : {"auto", "heft"}) {
    options.method = method;
    const auto policy = solve(app, platform, options);
    ASSERT_TRUE(policy.has_value()) << policy.error().to_string();
    EXPECT_TRUE(verify(app, platform, *policy, {.schedules = 10}).truthful());
  }
  app.xnodes[1].wcet_us["cpu"] += 2;
  const auto refused = solve(app, platform, options);
  ASSERT_FALSE(refused.has_value());
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  EXPECT_NE(refused.error().to_string().find("sum to 1000000000002 us"), std::string::npos)
      << refused.error().to_string();
}

/// Layers of `width`, each XNode behind `fan` of the layer before: the shape that costs most, for
/// everything is open to everything in its layer.
AppSpec layered(int nodes, int width, int fan) {
  AppSpec app;
  app.name = "layered";
  test::Dice dice(5);
  for (int i = 0; i < nodes; ++i) {
    app.xnodes.push_back({test::numbered("x", i), "m", {{"cpu", dice.roll(100, 900)}}});
    if (dice.chance(60)) app.xnodes.back().wcet_us["gpu"] = dice.roll(50, 300);
    const int layer = i / width * width;
    for (int k = 0; k < fan && layer > 0; ++k)
      app.edges.emplace_back(layer - width + (i + k * 7) % width, i);
  }
  return app;
}

/// The rule of solve.h in CPU time, which a busy machine does not lengthen, of one thread.
TEST(Solve, TheLargestAppsKeepTheTimeLimitAndAStop) {
  const Platform platform = *Platform::builtin("small");
  const auto cpu_s = [] {
    timespec time{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_nsec) * 1e-9;
  };
  for (const AppSpec& app : {layered(20'000, 2000, 3), layered(20'000, 20'000, 1),
                             layered(20'000, 10, 2), layered(5000, 500, 60)}) {
    for (const char* method : {"auto", "heft"}) {
      const std::string what = std::to_string(app.xnodes.size()) + " XNodes, " +
                               std::to_string(app.edges.size()) + " edges, " + method;
      SolveOptions options;
      options.method = method;
      options.time_limit_s = 0.5;
      const double began = cpu_s();
      const auto policy = solve(app, platform, options);
      EXPECT_LT(cpu_s() - began, kSlack * (1.3 * options.time_limit_s + 1)) << what;
      ASSERT_TRUE(policy.has_value()) << what;
      EXPECT_LE(policy->lower_bound_us, policy->latency_us);

      const std::atomic<bool> stop{true};
      options.stop = &stop;
      options.time_limit_s = 1000;
      const double stopped = cpu_s();
      ASSERT_TRUE(solve(app, platform, options).has_value());
      EXPECT_LT(cpu_s() - stopped, kSlack * 1) << what;
    }
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

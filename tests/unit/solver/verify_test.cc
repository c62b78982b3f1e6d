// SPDX-License-Identifier: Apache-2.0
#include "reference/verify.h"

#include <functional>

#include <gtest/gtest.h>

#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "brute_force.h"
#include "problem_random.h"
#include "reference/verify_world.h"

namespace xauto::solver::test {
namespace {

struct Case {
  AppSpec app;
  Platform platform;
  PriorityPlan policy;
};

/// A policy whose every number is true and says as much as can be said.
Case truthful(int nodes, std::uint64_t seed) {
  GenerateOptions options;
  options.nodes = nodes;
  options.seed = seed;
  Case c{*generate(options), *Platform::builtin("small"), {}};
  const Problem p = *Problem::create(c.app, c.platform);
  c.policy = make_policy(c.app, c.platform, p, heft(p), "heft");
  c.policy.lower_bound_us = verification::simple_bound(verification::World(c.app, c.platform));
  c.policy.optimal = false;
  return c;
}

/// a: cpu 10 -> b: gpu 5, beside c: gpu 20; the GPU preempts for 1.
Case tiny(std::int64_t preempt_us) {
  Case c;
  c.app.name = "tiny";
  c.app.xnodes = {{"a", "A", {{"cpu", 10}}}, {"b", "B", {{"gpu", 5}}}, {"c", "C", {{"gpu", 20}}}};
  c.app.edges = {{0, 1}};
  c.platform = {"p", {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, preempt_us, 0, -1}}};
  const Problem p = *Problem::create(c.app, c.platform);
  Decision d{{0, 1, 1}, {3, 1, 2}, {}};
  c.policy = make_policy(c.app, c.platform, p, d, "search");
  c.policy.lower_bound_us = 25;
  c.policy.optimal = true;
  return c;
}

bool tells_lie(const Case& c, const std::string& about) {
  const Verification v = verify(c.app, c.platform, c.policy, {.schedules = 2000});
  for (const std::string& lie : v.lies)
    if (lie.find(about) != std::string::npos) return true;
  for (const std::string& lie : v.lies) ADD_FAILURE() << "another lie: " << lie;
  return false;
}

TEST(Verify, AcceptsATruthfulPolicyAndSaysWhatItShowed) {
  const Case c = tiny(1);
  const Verification v = verify(c.app, c.platform, c.policy);
  for (const std::string& lie : v.lies) ADD_FAILURE() << lie;
  EXPECT_TRUE(v.bound_proven);
  EXPECT_EQ(v.latency_us, 25);
  EXPECT_EQ(v.shown.size(), 4U);
  EXPECT_TRUE(v.taken.empty());
}

TEST(Verify, AcceptsHeftAndLocalOnTheSyntheticWorkload) {
  for (const char* method : {"heft", "local"})
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
      GenerateOptions options;
      options.nodes = 25;
      options.seed = seed;
      const AppSpec app = *generate(options);
      for (const char* name : {"small", "large"}) {
        const Platform platform = *Platform::builtin(name);
        SolveOptions solving;
        solving.method = method;
        const auto policy = solve(app, platform, solving);
        ASSERT_TRUE(policy);
        const Verification v = verify(app, platform, *policy, {.schedules = 3000});
        for (const std::string& lie : v.lies) ADD_FAILURE() << method << " " << seed << ": " << lie;
      }
    }
}

TEST(Verify, AcceptsSearchAndAutoOnSmallApps) {
  for (const char* method : {"search", "auto"})
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
      GenerateOptions options;
      options.nodes = 12;
      options.seed = seed;
      const AppSpec app = *generate(options);
      SolveOptions solving;
      solving.method = method;
      solving.time_limit_s = 2;
      solving.max_evaluations = 20'000;
      const auto policy = solve(app, *Platform::builtin("small"), solving);
      ASSERT_TRUE(policy);
      const Verification v = verify(app, *Platform::builtin("small"), *policy, {.schedules = 3000});
      for (const std::string& lie : v.lies) ADD_FAILURE() << method << " " << seed << ": " << lie;
    }
}

TEST(Verify, RejectsAWrongLatency) {
  Case c = truthful(20, 1);
  --c.policy.latency_us;
  EXPECT_TRUE(tells_lie(c, "latency_us is said to be"));
}

TEST(Verify, RejectsAWrongStart) {
  Case c = truthful(20, 1);
  for (PriorityPlacement& p : c.policy.placements)
    if (p.start_us > 0) {
      --p.start_us;
      break;
    }
  EXPECT_TRUE(tells_lie(c, "is said to run from"));
}

TEST(Verify, RejectsAWrongFinish) {
  Case c = truthful(20, 1);
  ++c.policy.placements[3].finish_us;
  EXPECT_TRUE(tells_lie(c, "is said to run from"));
}

TEST(Verify, RejectsSwappedPriorities) {
  Case c = tiny(1);
  std::swap(c.policy.placements[1].priority, c.policy.placements[2].priority);
  EXPECT_TRUE(tells_lie(c, "is said to run from"));
}

TEST(Verify, RejectsALowerBoundAboveTheLatency) {
  Case c = truthful(20, 1);
  c.policy.lower_bound_us = c.policy.latency_us + 1;
  EXPECT_TRUE(tells_lie(c, "above the policy's own latency"));
}

TEST(Verify, RejectsALowerBoundAboveASchedule) {
  // HEFT is not optimal here; its latency as a bound is refuted by a schedule.
  int refuted = 0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    Case c = truthful(30, seed);
    c.policy.lower_bound_us = c.policy.latency_us;
    const Verification v = verify(c.app, c.platform, c.policy);
    for (const std::string& lie : v.lies)
      refuted += lie.find("is above a schedule of") != std::string::npos;
  }
  EXPECT_GE(refuted, 4);
}

TEST(Verify, ANumberBelowABoundIsACounterexample) {
  Case c = tiny(1);
  const std::int64_t latency = c.policy.latency_us;
  EXPECT_EQ(verify(c.app, c.platform, c.policy).counterexample, "");
  // Its own bound.
  c.policy.lower_bound_us = latency + 3;
  EXPECT_EQ(verify(c.app, c.platform, c.policy).counterexample,
            "this policy takes " + std::to_string(latency) +
                " us, but this policy claims that none takes less than " +
                std::to_string(latency + 3) + " us");
  // That of another policy of the same app, while this one says nothing wrong.
  c = tiny(1);
  VerifyOptions against;
  against.other_bound_us = latency;
  EXPECT_EQ(verify(c.app, c.platform, c.policy, against).counterexample, "");
  against.other_bound_us = latency + 1;
  const Verification v = verify(c.app, c.platform, c.policy, against);
  EXPECT_TRUE(v.truthful());
  EXPECT_NE(v.counterexample.find("the other policy claims"), std::string::npos);
}

TEST(Verify, FindsAPolicyThatIsOrderedOnOneXpuAndPreemptsOnAnother) {
  // What `solve` once called optimal: 27 ms, the best of all order and of all priorities.
  Case c;
  c.app.name = "mixed";
  const std::vector<std::pair<const char*, std::int64_t>> wcets = {
      {"gpu", 9000}, {"dla", 1000}, {"gpu", 7000}, {"dla", 7000},
      {"dla", 3000}, {"dla", 1000}, {"gpu", 8000}, {"dla", 8000}};
  for (std::size_t i = 0; i < wcets.size(); ++i)
    c.app.xnodes.push_back(
        {numbered("x", static_cast<int>(i)), "m", {{wcets[i].first, wcets[i].second}}});
  c.app.edges = {{1, 3}, {2, 4}, {3, 5}, {4, 6}, {6, 7}};
  c.platform.name = "gpu and dla";
  c.platform.xpus = {{"gpu0", "gpu", true, 0, 0, -1}, {"dla0", "dla", false, 0, 0, -1}};
  const Problem p = *Problem::create(c.app, c.platform);
  Decision d = brute_force(p).decision;
  c.policy = make_policy(c.app, c.platform, p, d, "auto");
  ASSERT_EQ(c.policy.latency_us, 27'000);
  c.policy.lower_bound_us = 27'000;
  c.policy.optimal = true;
  const Verification v = verify(c.app, c.platform, c.policy);
  EXPECT_FALSE(v.truthful());
  EXPECT_EQ(v.counterexample,
            "a policy found here takes 26000 us, but this policy claims that none takes less than "
            "27000 us");
}

TEST(Verify, RejectsOptimalWithAGap) {
  Case c = truthful(20, 1);
  c.policy.optimal = true;
  EXPECT_TRUE(tells_lie(c, "optimal is claimed"));
}

TEST(Verify, RejectsOptimalWhereAnExhaustiveSearchFindsBetter) {
  Dice dice(1);
  int tampered = 0;
  for (int round = 0; round < 200; ++round) {
    Shape shape;
    shape.max_nodes = 6;
    Case c;
    c.platform = random_platform(dice, shape);
    c.app = random_app(dice, shape, c.platform);
    const Problem p = *Problem::create(c.app, c.platform);
    c.policy = make_policy(c.app, c.platform, p, random_decision(dice, p), "search");
    const Time best = brute_force(p).makespan;
    if (c.policy.latency_us == best) continue;
    ++tampered;
    c.policy.lower_bound_us = c.policy.latency_us;
    c.policy.optimal = true;
    VerifyOptions weak;
    weak.schedules = 0;  // only the proof is left to find out
    EXPECT_FALSE(verify(c.app, c.platform, c.policy, weak).truthful()) << round;
  }
  EXPECT_GT(tampered, 100);
}

TEST(Verify, RejectsAnotherAppsHash) {
  Case c = truthful(20, 1);
  c.policy.app_hash = "0000000000000000";
  EXPECT_TRUE(tells_lie(c, "another version of the app"));
}

TEST(Verify, RejectsAChangedApp) {
  Case c = truthful(20, 1);
  c.app.xnodes[0].wcet_us.begin()->second += 1;
  EXPECT_TRUE(tells_lie(c, "another version of the app"));
}

TEST(Verify, RejectsAnotherPlatform) {
  Case c = truthful(20, 1);
  c.policy.platform = "small";
  Platform large = *Platform::builtin("large");
  std::swap(c.platform, large);
  EXPECT_TRUE(tells_lie(c, "platform"));
}

TEST(Verify, RejectsAnXpuWithoutAnImplementation) {
  Case c = tiny(1);
  c.policy.placements[0].xpu = 1;
  EXPECT_TRUE(tells_lie(c, "has no implementation"));
}

TEST(Verify, RejectsTwoXNodesOfOnePriority) {
  Case c = tiny(1);
  c.policy.placements[1].priority = c.policy.placements[2].priority;
  EXPECT_TRUE(tells_lie(c, "has priority"));
}

TEST(Verify, RejectsAnOrderThatWouldHang) {
  Case c = tiny(1);
  c.policy.order = {{1, 2}, {2, 1}};
  EXPECT_TRUE(tells_lie(c, "cycle"));
}

TEST(Verify, RejectsNumbersThatForgetTheOrder) {
  Case c = tiny(1);
  c.policy.order = {{1, 2}};
  EXPECT_TRUE(tells_lie(c, "is said to run from"));
}

TEST(Verify, RejectsANegativeSolvingTime) {
  Case c = tiny(1);
  c.policy.solve_us = -1;
  EXPECT_TRUE(tells_lie(c, "is no time"));
}

TEST(Verify, OwnExecutionAgreesWithTheSimulator) {
  Dice dice(7);
  for (int round = 0; round < 2000; ++round) {
    const Platform platform = random_platform(dice, {});
    const AppSpec app = random_app(dice, {}, platform);
    const Problem p = *Problem::create(app, platform);
    Decision d = random_decision(dice, p);
    if (round % 2 == 0) add_random_order(dice, p, d, 30);
    verification::Candidate candidate{d.xpu, d.priority,
                                      std::vector<std::vector<int>>(app.xnodes.size())};
    for (const auto& [u, v] : d.order)
      candidate.order_before[static_cast<std::size_t>(v)].push_back(u);
    std::vector<Time> actual;
    for (int i = 0; i < p.num_xnodes; ++i)
      actual.push_back(
          dice.roll(0, static_cast<int>(p.wcet_on(i, d.xpu[static_cast<std::size_t>(i)]))));
    const auto own = verification::execute(verification::World(app, platform), candidate, actual);
    const Simulation theirs = simulate(p, d, {.actual = actual});
    ASSERT_EQ(own.finish, theirs.finish);
    ASSERT_EQ(own.start, theirs.start);
  }
}

TEST(Verify, APolicyMadeWithPinsAndGroupsTellsTheTruthAboutThem) {
  // Its bound is above what the app could do without them, which must not be called a lie.
  Dice dice(31);
  int above_free = 0, solved = 0;
  for (int round = 0; round < 60; ++round) {
    Shape shape;
    shape.max_nodes = 7;
    const Platform platform = random_platform(dice, shape);
    const AppSpec app = random_app(dice, shape, platform);
    SolveOptions options;
    options.max_evaluations = 3000;
    options.time_limit_s = 1e9;
    const auto pick = [&] {
      return app
          .xnodes[static_cast<std::size_t>(dice.roll(0, static_cast<int>(app.xnodes.size()) - 1))]
          .name;
    };
    const auto xpu = [&] {
      return platform
          .xpus[static_cast<std::size_t>(dice.roll(0, static_cast<int>(platform.xpus.size()) - 1))]
          .id;
    };
    options.objectives.pins = {{pick(), xpu()}};
    options.objectives.forbids = {{pick(), xpu()}};
    if (round % 3 == 0) options.objectives.groups = {{app.xnodes[0].name, app.xnodes[1].name}};
    options.objectives.chains = {{"all", app.xnodes[0].name, app.xnodes[0].name, 1}};
    const auto policy = solve(app, platform, options);
    if (!policy) continue;  // no XPU left: refused
    ++solved;
    VerifyOptions verify_options;
    verify_options.schedules = 2000;
    verify_options.asked = options.objectives;
    const Verification v = verify(app, platform, *policy, verify_options);
    EXPECT_TRUE(v.truthful()) << "round " << round << ": " << v.lies.front();
    verify_options.asked = {};
    above_free += !verify(app, platform, *policy, verify_options).truthful();
  }
  EXPECT_GT(solved, 20);
  EXPECT_GT(above_free, 3);  // without them the same bounds are lies, and found
}

TEST(Verify, ABrokenPinAndAMissedDeadlineAreNamed) {
  AppSpec app;
  app.name = "two";
  app.xnodes = {{"camera", "m", {{"cpu", 4}, {"gpu", 2}}}, {"brakes", "m", {{"cpu", 6}}}};
  app.edges = {{0, 1}};
  Platform platform;
  platform.name = "p";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 0, 0, -1}};
  SolveOptions options;
  options.max_evaluations = 500;
  const PriorityPlan policy = *solve(app, platform, options);
  ASSERT_EQ(policy.latency_us, 8);
  VerifyOptions asked;
  asked.asked.pins = {{"camera", "cpu"}};
  const Verification pinned = verify(app, platform, policy, asked);
  ASSERT_FALSE(pinned.truthful());
  EXPECT_NE(pinned.lies.front().find("'camera' must run on cpu, it runs on gpu0"),
            std::string::npos);
  asked.asked = {};
  asked.asked.groups = {{"camera", "brakes"}};
  EXPECT_FALSE(verify(app, platform, policy, asked).truthful());
  asked.asked = {};
  asked.asked.forbids = {{"camera", "gpu0"}};
  EXPECT_FALSE(verify(app, platform, policy, asked).truthful());
  asked.asked = {};
  asked.asked.pins = {{"lidar", "cpu"}};
  EXPECT_NE(verify(app, platform, policy, asked).lies.front().find("lidar"), std::string::npos);
  asked.asked = {};
  asked.asked.chains = {{"stop", "camera", "brakes", 7}, {"see", "camera", "camera", 7}};
  const Verification late = verify(app, platform, policy, asked);
  EXPECT_TRUE(late.truthful());
  ASSERT_EQ(late.missed.size(), 1U);
  EXPECT_EQ(late.missed.front(), "chain 'stop': 8 us, its deadline is 7 us");
}

TEST(Verify, OwnProofsAgreeWithBruteForce) {
  Dice dice(8);
  int by_types = 0;
  for (int round = 0; round < 300; ++round) {
    Shape shape;
    shape.max_nodes = 7;
    const Platform platform = random_platform(dice, shape);
    const AppSpec app = random_app(dice, shape, platform);
    const Problem p = *Problem::create(app, platform);
    const verification::World world(app, platform);
    const Time best = brute_force(p).makespan;
    ASSERT_EQ(verification::prove_by_execution(world, best, 10'000'000),
              verification::Proof::kHolds);
    ASSERT_EQ(verification::prove_by_execution(world, best + 1, 10'000'000),
              verification::Proof::kBeaten);
    ASSERT_LE(verification::simple_bound(world), best);
    ASSERT_NE(verification::prove_by_types(world, best + 1, 100'000), verification::Proof::kHolds);
    by_types += verification::prove_by_types(world, best, 100'000) == verification::Proof::kHolds;
  }
  EXPECT_GT(by_types, 100);
}

}  // namespace
}  // namespace xauto::solver::test

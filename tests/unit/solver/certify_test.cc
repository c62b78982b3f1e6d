// SPDX-License-Identifier: Apache-2.0
// The worst case, attacked: random and cornered execution times must never exceed it.
#include "solver/certify.h"

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

TEST(Certify, NoExecutionOfAFixedPriorityPolicyExceedsItsWorstCase) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(seed);
    const Case c = random_case(dice, 14);
    const Decision decision = test::random_decision(dice, c.problem);
    const Time bound = worst_case(c.problem, decision);
    ASSERT_LE(simulate(c.problem, decision).makespan, bound) << "seed " << seed;
    ASSERT_LE(longest_execution(dice, c.problem, decision, 150), bound) << "seed " << seed;
  }
}

TEST(Certify, NoExecutionWithSomeOrderPairsExceedsTheWorstCase) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(700 + seed);
    const Case c = random_case(dice, 14);
    Decision decision = test::random_decision(dice, c.problem);
    test::add_random_order(dice, c.problem, decision, 30);
    ASSERT_LE(longest_execution(dice, c.problem, decision, 150), worst_case(c.problem, decision))
        << "seed " << seed;
  }
}

TEST(Certify, AnOrderedScheduleIsItsOwnWorstCase) {
  for (std::uint64_t seed = 0; seed < 150; ++seed) {
    test::Dice dice(1500 + seed);
    const Case c = random_case(dice, 16);
    const Decision random = test::random_decision(dice, c.problem);
    OrderedEvaluator evaluator(c.problem);
    evaluator.reset(random.xpu, sequence_of(random.priority));
    const Solution solution{evaluator.xpu(), evaluator.sequence(), evaluator.makespan(), true};
    Decision decision = to_decision(solution);
    decision.order = order_pairs(c.problem, solution);
    ASSERT_EQ(simulate(c.problem, decision).makespan, solution.makespan) << "seed " << seed;
    ASSERT_EQ(worst_case(c.problem, decision), solution.makespan) << "seed " << seed;
    ASSERT_LE(longest_execution(dice, c.problem, decision, 60), solution.makespan);
  }
}

TEST(Certify, OrderPairsAreMinimal) {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    test::Dice dice(3000 + seed);
    const Case c = random_case(dice, 14);
    const Decision random = test::random_decision(dice, c.problem);
    OrderedEvaluator evaluator(c.problem);
    evaluator.reset(random.xpu, sequence_of(random.priority));
    const auto pairs = order_pairs(c.problem, {evaluator.xpu(), evaluator.sequence(), 0, true});
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

TEST(Certify, TheAnomalyOfAShorterJobIsCovered) {
  // Random policies of which some do run longer with shorter jobs; the bound holds for those too.
  int anomalies = 0;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(4000 + seed);
    const Case c = random_case(dice, 14);
    const Decision decision = test::random_decision(dice, c.problem);
    const Time at_wcet = simulate(c.problem, decision).makespan;
    const Time longest = longest_execution(dice, c.problem, decision, 200);
    if (longest > at_wcet) ++anomalies;
    ASSERT_LE(longest, worst_case(c.problem, decision));
  }
  EXPECT_GT(anomalies, 0);  // the test would prove nothing otherwise
}

TEST(Certify, CertifyingTakesTheLeastCertifiedLatency) {
  test::Dice dice(77);
  const Case c = random_case(dice, 14);
  SolveOptions options;
  options.max_evaluations = 20'000;
  options.time_limit_s = 1e9;
  options.certify = true;
  const auto policy = solve(c.app, c.platform, options);
  ASSERT_TRUE(policy.has_value());
  EXPECT_EQ(policy->worst_case_us, policy->latency_us);
}

TEST(Certify, PrioritiesByDeadlineAreSafeAndCloseToTheLatency) {
  int applies = 0, tighter = 0, plain = 0;
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    test::Dice dice(80'000 + seed);
    Case c = random_case(dice, 16);
    for (char& preemptive : c.problem.preemptive)
      if (seed % 4 != 0) preemptive = 1;
    const Decision drawn = test::random_decision(dice, c.problem);
    const Decision settled = settle_priorities(c.problem, drawn);
    ASSERT_LE(simulate(c.problem, settled).makespan, simulate(c.problem, drawn).makespan);
    ASSERT_EQ(settled.xpu, drawn.xpu);
    const auto certificate = deadline_certificate(c.problem, settled);
    if (!certificate) continue;
    ++applies;
    ASSERT_GE(*certificate, simulate(c.problem, settled).makespan);
    ASSERT_LE(longest_execution(dice, c.problem, settled, 400), *certificate) << "seed " << seed;
    plain += worst_case(c.problem, drawn) > *certificate;
    tighter += worst_case(c.problem, settled) < worst_case(c.problem, drawn);
  }
  EXPECT_GT(applies, 150);
  EXPECT_GT(plain, 60);
  EXPECT_GT(tighter, 60);
}

TEST(Certify, OrderOnSomeXpusAndPrioritiesByDeadlineOnOthersAreSafe) {
  int applies = 0, mixed = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    test::Dice dice(90'000 + seed);
    const Case c = random_case(dice, 14);
    Decision decision = test::random_decision(dice, c.problem);
    // Full order where nothing preempts, some or no pairs elsewhere.
    for (std::size_t a = 0; a < c.problem.topo.size(); ++a)
      for (std::size_t b = a + 1; b < c.problem.topo.size(); ++b) {
        const int u = c.problem.topo[a], v = c.problem.topo[b];
        const int x = decision.xpu[static_cast<std::size_t>(u)];
        if (x != decision.xpu[static_cast<std::size_t>(v)]) continue;
        if (!c.problem.preemptive[static_cast<std::size_t>(x)] || dice.chance(15))
          decision.order.emplace_back(u, v);
      }
    const Decision settled = settle_priorities(c.problem, decision);
    ASSERT_EQ(settled.order, decision.order);
    const auto certificate = deadline_certificate(c.problem, settled);
    if (!certificate) continue;
    ++applies;
    mixed += simulate(c.problem, settled).preemptions > 0 && !settled.order.empty();
    ASSERT_GE(*certificate, simulate(c.problem, settled).makespan) << "seed " << seed;
    ASSERT_LE(longest_execution(dice, c.problem, settled, 300), *certificate) << "seed " << seed;
  }
  EXPECT_GT(applies, 200);
  EXPECT_GT(mixed, 20);
}

TEST(Certify, TheOrderOfAnUndisturbedXpuChangesNothingAtWcet) {
  int added = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    test::Dice dice(95'000 + seed);
    const Case c = random_case(dice, 14);
    Decision decision = test::random_decision(dice, c.problem);
    test::add_random_order(dice, c.problem, decision, 10);
    const Decision ordered = order_undisturbed(c.problem, decision);
    ASSERT_EQ(simulate(c.problem, ordered).finish, simulate(c.problem, decision).finish) << seed;
    ASSERT_LE(longest_execution(dice, c.problem, ordered, 60), worst_case(c.problem, ordered));
    added += ordered.order.size() > decision.order.size();
  }
  EXPECT_GT(added, 100);
}

/// Chains that meet on one GPU only: each comes to it and goes on by a processor of its own.
Case meeting_on_a_gpu(test::Dice& dice, int chains, int levels) {
  Case c;
  c.app.name = "meeting";
  c.platform.name = "p";
  c.platform.xpus = {{"gpu0", "gpu", true, dice.roll(0, 3), 0, -1, levels}};
  for (int k = 0; k < chains; ++k) {
    const std::string own = test::numbered("own", k);
    c.platform.xpus.push_back({own, own, true, 0, 0, -1});
    c.app.xnodes.push_back({own + ".in", own, {{own, dice.roll(1, 20)}}});
    c.app.xnodes.push_back({own + ".gpu", own, {{"gpu", dice.roll(1, 15)}}});
    c.app.xnodes.push_back({own + ".out", own, {{own, dice.roll(1, 60)}}});
    c.app.edges.emplace_back(3 * k, 3 * k + 1);
    c.app.edges.emplace_back(3 * k + 1, 3 * k + 2);
  }
  c.problem = Problem::create(c.app, c.platform).value();
  return c;
}

TEST(Certify, TheWorstCaseCountsWithLevelsThatAreTaken) {
  int beyond = 0, enough = 0;
  for (std::uint64_t seed = 0; seed < 1500; ++seed) {
    test::Dice dice(110'000 + seed);
    const int levels = 2 + static_cast<int>(seed % 2);
    Case c = meeting_on_a_gpu(dice, dice.roll(3, 6), levels);
    Decision decision = test::random_decision(dice, c.problem);
    if (seed % 3 == 0) decision = settle_priorities(c.problem, decision);
    if (seed % 3 == 1) test::add_random_order(dice, c.problem, decision, 20);
    const Time bound = worst_case(c.problem, decision);
    const Time longest = longest_execution(dice, c.problem, decision, 300);
    ASSERT_LE(longest, bound) << "seed " << seed;
    if (const auto by_deadlines = deadline_certificate(c.problem, decision)) {
      ++enough;
      ASSERT_LE(longest, *by_deadlines) << "seed " << seed;
    }
    // Without that the bound would be exceeded, so this test can fail.
    Problem unlimited = c.problem;
    unlimited.levels.assign(unlimited.levels.size(), 0);
    beyond += longest > worst_case(unlimited, decision);
  }
  EXPECT_GT(beyond, 10);
  EXPECT_GT(enough, 10);
}

TEST(Certify, WhereLevelsSufficeAnXpuIsAsPreemptiveAsAnyOther) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    test::Dice dice(120'000 + seed);
    Case c = meeting_on_a_gpu(dice, 4, 4);
    const Decision decision = test::random_decision(dice, c.problem);
    Problem unlimited = c.problem;
    unlimited.levels.assign(unlimited.levels.size(), 0);
    ASSERT_EQ(worst_case(c.problem, decision), worst_case(unlimited, decision));
    const Simulation at_wcet = simulate(c.problem, decision);
    if (c.problem.preempt[0] == 0) {
      ASSERT_EQ(at_wcet.finish, simulate(unlimited, decision).finish);
    }
    // Who comes at the end of another pays above those that are suspended.
    ASSERT_LE(at_wcet.makespan, worst_case(unlimited, decision));
  }
}

TEST(Certify, NoCertificateWherePrioritiesDoNotFollowTheFinishes) {
  // gpu: long first by priority although short, ready at the same time, would end sooner in any
  // order by finish that puts it first; the certificate must not claim what it cannot show.
  AppSpec app;
  app.name = "two";
  app.xnodes = {{"root", "m", {{"cpu", 1}}},
                {"low", "m", {{"gpu", 5}}},
                {"high", "m", {{"gpu", 3}}},
                {"last", "m", {{"cpu", 9}}}};
  app.edges = {{0, 2}, {1, 3}};
  Platform platform;
  platform.name = "p";
  platform.xpus = {{"cpu0", "cpu", true, 0, 0, -1}, {"gpu0", "gpu", true, 2, 0, -1}};
  const Problem problem = Problem::create(app, platform).value();
  // high preempts low at 1: it ends at 1 + 2 + 3 = 6, low at 10. F of high is 6, of low 10:
  // follows.
  const Decision by_finish{{0, 1, 1, 0}, {3, 1, 2, 2}, {}};
  EXPECT_EQ(deadline_certificate(problem, by_finish), std::optional<Time>(19));
  EXPECT_EQ(simulate(problem, by_finish).makespan, 19);
  // On a GPU that cannot preempt, nothing of the kind is claimed.
  platform.xpus[1].preemptive = false;
  EXPECT_FALSE(deadline_certificate(Problem::create(app, platform).value(), by_finish));
  // Unless the two are ordered at run time.
  Decision ordered = by_finish;
  ordered.order = {{1, 2}};
  EXPECT_EQ(deadline_certificate(Problem::create(app, platform).value(), ordered),
            std::optional<Time>(14));
}

}  // namespace
}  // namespace xauto::solver

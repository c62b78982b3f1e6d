// SPDX-License-Identifier: Apache-2.0
// What solve() claims of apps of several rates, against a naive simulator (keys_naive.h).
#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/solve.h"

#include "keys_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

struct Played {
  int policies = 0, unsustainable = 0, unknown = 0;
  std::int64_t jobs = 0;
};

/// Solves random apps and plays each policy many times; `blind` is what the solver is told instead
/// of the truth. Returns what broke first.
std::string attack(const RatedShape& shape, int apps, int plays, std::uint64_t seed, Played& played,
                   const std::function<void(AppSpec&, Platform&)>& blind = {}) {
  for (int a = 0; a < apps; ++a) {
    solver::test::Dice dice(seed * 100'003 + static_cast<std::uint64_t>(a));
    const AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    AppSpec told = app;
    Platform on = platform;
    if (blind) blind(told, on);
    const Result<Answer> answer = solve(told, on, brief(60));
    if (!answer) {
      ADD_FAILURE() << answer.error().to_string();
      continue;
    }
    if (answer->outcome == Outcome::kUnsustainable) ++played.unsustainable;
    if (answer->outcome == Outcome::kUnknown) ++played.unknown;
    if (answer->outcome != Outcome::kPolicy) continue;
    ++played.policies;
    const Status sound = validate(answer->policy, told, on);
    EXPECT_TRUE(sound) << (sound ? "" : sound.error().to_string());
    if (!blind) {
      const auto derived = check(app, platform, answer->policy);
      EXPECT_TRUE(derived) << "app " << a << ": " << (derived ? "" : derived.error().to_string());
    }
    const std::string broken = play_naively(app, platform, answer->policy, plays, 14, played.jobs);
    if (!broken.empty()) return "app " + std::to_string(a) + " " + broken;
  }
  return {};
}

RatedShape one_clock() {
  return {};
}

RatedShape two_clocks(int ppm) {
  RatedShape shape;
  shape.clocks = 2;
  shape.max_components = 3;
  shape.ppm = ppm;
  shape.least_period = 14;
  return shape;
}

TEST(KeysSolve, NoExecutionOfOneClockBreaksAPolicy) {
  Played played;
  EXPECT_EQ(attack(one_clock(), 150, 24, 1, played), "");
  EXPECT_GT(played.policies, 100);
  EXPECT_GT(played.jobs, 10'000);
}

TEST(KeysSolve, NoExecutionOfAPipelineBreaksAPolicy) {
  RatedShape shape;
  shape.max_components = 1;
  shape.max_nodes = 6;
  shape.least_period = 6;
  shape.most_period = 10;
  Played played;
  EXPECT_EQ(attack(shape, 150, 24, 2, played), "");
  EXPECT_GT(played.policies, 50);
}

TEST(KeysSolve, NoExecutionWithFractionalPeriodsBreaksAPolicy) {
  RatedShape shape;
  shape.fractions = true;
  Played played;
  EXPECT_EQ(attack(shape, 100, 20, 3, played), "");
  EXPECT_GT(played.policies, 50);
}

TEST(KeysSolve, NoPhaseOfTwoClocksBreaksAPolicy) {
  Played played;
  EXPECT_EQ(attack(two_clocks(0), 120, 40, 4, played), "");
  EXPECT_GT(played.policies, 60);
}

TEST(KeysSolve, NoDriftBreaksAPolicy) {
  // Clocks far worse than any, so that a few activations are enough.
  RatedShape shape = two_clocks(20'000);
  shape.least_period = 20;
  Played played;
  EXPECT_EQ(attack(shape, 120, 40, 5, played), "");
  EXPECT_GT(played.policies, 40);
}

// What the proof takes into account, left out: the same attack has to find each.

TEST(KeysSolve, ClocksThatDriftALotAreNoTrouble) {
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.clocks = 2;
    shape.max_components = 4;
    shape.least_period = 12;
    shape.ppm = 20'000;
    Platform platform = random_rated_platform(dice);
    platform.xpus.push_back({"cpu8", "cpu", true, 0});
    platform.xpus.push_back({"gpu8", "gpu", true, 0});
    const AppSpec app = random_rated_app(dice, shape);
    Options options;
    options.max_evaluations = 200;
    options.seed = seed;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer) << "seed " << seed;
    if (answer->outcome != Outcome::kPolicy) continue;
    EXPECT_TRUE(check(app, platform, answer->policy)) << "seed " << seed;
  }
}

TEST(KeysSolve, TheAttackFindsJitterThatIsLeftOut) {
  Played played;
  EXPECT_NE(attack(one_clock(), 150, 24, 1, played,
                   [](AppSpec& app, Platform&) {
                     for (SourceSpec& s : app.sources) s.jitter_us = 0;
                   }),
            "");
}

TEST(KeysSolve, TheAttackFindsThePreemptionChargeThatIsLeftOut) {
  Played played;
  EXPECT_NE(attack(one_clock(), 300, 24, 6, played,
                   [](AppSpec&, Platform& platform) {
                     for (Xpu& xpu : platform.xpus) xpu.preempt_us = 0;
                   }),
            "");
}

TEST(KeysSolve, TheAttackFindsTheBlockingThatIsLeftOut) {
  Played played;
  EXPECT_NE(attack(one_clock(), 300, 24, 7, played,
                   [](AppSpec&, Platform& platform) {
                     for (Xpu& xpu : platform.xpus) xpu.preemptive = true;
                   }),
            "");
}

TEST(KeysSolve, TheAttackFindsTheLimitInFlightThatIsLeftOut) {
  RatedShape shape;
  shape.max_components = 1;
  shape.max_nodes = 6;
  shape.least_period = 6;
  shape.most_period = 10;
  Played played;
  EXPECT_NE(attack(shape, 400, 24, 2, played,
                   [](AppSpec& app, Platform&) {
                     for (ModuleSpec& m : app.modules) m.max_in_flight = 9;
                   }),
            "");
}

TEST(KeysSolve, TheAttackFindsTransfersThatAreLeftOut) {
  Played played;
  EXPECT_NE(attack(one_clock(), 300, 24, 8, played,
                   [](AppSpec& app, Platform&) { app.transfers.clear(); }),
            "");
}

TEST(KeysSolve, TheAttackFindsClocksThatAreTakenForOne) {
  Played played;
  EXPECT_NE(attack(two_clocks(0), 150, 40, 4, played,
                   [](AppSpec& app, Platform&) {
                     for (SourceSpec& s : app.sources) s.clock = 0;
                   }),
            "");
}

TEST(KeysSolve, TheAnswerDependsOnSeedThreadsAndBudgetOnly) {
  solver::test::Dice dice(99);
  const AppSpec app = random_rated_app(dice, {});
  const Platform platform = random_rated_platform(dice);
  Options two = brief(300);
  two.threads = 2;
  const Result<Answer> a = solve(app, platform, two), b = solve(app, platform, two);
  ASSERT_TRUE(a && b);
  ASSERT_EQ(a->outcome, Outcome::kPolicy);
  EXPECT_EQ(a->policy.placements, b->policy.placements);
  EXPECT_EQ(a->policy.chains, b->policy.chains);
}

TEST(KeysSolve, AHintIsKeptAndProvenAgain) {
  solver::test::Dice dice(99);
  const AppSpec app = random_rated_app(dice, {});
  const Platform platform = random_rated_platform(dice);
  const Result<Answer> a = solve(app, platform, brief(300));
  ASSERT_TRUE(a);
  ASSERT_EQ(a->outcome, Outcome::kPolicy);
  Options options = brief(200);
  options.hint = &a->policy;
  options.keep = Keep::kPlacement;
  const Result<Answer> b = solve(app, platform, options);
  ASSERT_TRUE(b);
  ASSERT_EQ(b->outcome, Outcome::kPolicy);
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    EXPECT_EQ(b->policy.placements[i].xpu, a->policy.placements[i].xpu);
  Policy other = a->policy;
  other.placements.pop_back();
  options.hint = &other;
  EXPECT_FALSE(solve(app, platform, options));
}

/// Its pairs are of its own keys: whoever wins, order and keys are of one answer.
TEST(KeysSolve, AHintWithOrderStaysTrue) {
  int ordered = 0;
  for (std::uint64_t seed = 1; seed <= 120; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.offsets = false;
    shape.max_components = 3;
    AppSpec app = random_rated_app(dice, shape);
    for (SourceSpec& source : app.sources) source.period = {60};
    const Platform platform = random_rated_platform(dice);
    const Result<Answer> before = solve(app, platform, brief(100));
    ASSERT_TRUE(before) << seed;
    if (before->outcome != Outcome::kPolicy || before->policy.order.empty()) continue;
    ++ordered;
    for (const Keep keep : {Keep::kNothing, Keep::kPlacement}) {
      Options options = brief(100);
      options.hint = &before->policy;
      options.keep = keep;
      const Result<Answer> after = solve(app, platform, options);
      ASSERT_TRUE(after && after->outcome == Outcome::kPolicy) << seed;
      const auto checked = check(app, platform, after->policy);
      EXPECT_TRUE(checked) << seed << ": " << checked.error().to_string();
      if (keep == Keep::kPlacement) {
        EXPECT_TRUE(after->moved.empty()) << seed;
      }
    }
  }
  EXPECT_GT(ordered, 5);
}

/// Whatever the search would make of it: with its holds, and with a key for each activation.
TEST(KeysSolve, NoAnswerIsWorseThanItsHint) {
  int asked = 0, by_activation = 0, held = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    solver::test::Dice dice(seed);
    const RatedShape shape = seed % 2 == 0 ? two_clocks(100) : RatedShape{.max_components = 3};
    const AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    const Result<Answer> before = solve(app, platform, brief(1500));
    ASSERT_TRUE(before) << seed;
    if (before->outcome != Outcome::kPolicy) continue;
    ++asked;
    for (const Placement& placed : before->policy.placements) {
      by_activation += placed.key_us.size() > 1;
      held += !placed.hold_us.empty();
    }
    for (const std::int64_t evaluations : {1, 30}) {
      Options options = brief(evaluations);
      options.seed = 7;
      options.hint = &before->policy;
      const Result<Answer> after = solve(app, platform, options);
      ASSERT_TRUE(after && after->outcome == Outcome::kPolicy) << seed;
      EXPECT_LE(after->totals.sum, before->totals.sum) << seed;
      EXPECT_TRUE(check(app, platform, after->policy)) << seed;
    }
    // Of one that is not certified nothing is believed.
    Policy wrong = before->policy;
    wrong.placements.front().key_us.front() = 0;
    Options options = brief(30);
    options.hint = &wrong;
    const Result<Answer> after = solve(app, platform, options);
    ASSERT_TRUE(after) << seed;
    if (after->outcome == Outcome::kPolicy) {
      EXPECT_TRUE(check(app, platform, after->policy)) << seed;
    }
  }
  EXPECT_GT(asked, 40);
  EXPECT_GE(by_activation, 10);
  EXPECT_GT(held, 40);
}

std::vector<int> elsewhere(const Policy& a, const Policy& b) {
  std::vector<int> xnodes;
  for (std::size_t i = 0; i < a.placements.size(); ++i)
    if (a.placements[i].xpu >= 0 && a.placements[i].xpu != b.placements[i].xpu)
      xnodes.push_back(static_cast<int>(i));
  return xnodes;
}

TEST(KeysSolve, TheAnswerTellsWhoIsElsewhereThanInItsHint) {
  int asked = 0, moved = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    solver::test::Dice dice(seed);
    const AppSpec app = random_rated_app(dice, {});
    const Platform platform = random_rated_platform(dice);
    const Result<Answer> before = solve(app, platform, brief(300));
    ASSERT_TRUE(before) << seed;
    if (before->outcome != Outcome::kPolicy) continue;
    Options options = brief(600);
    options.hint = &before->policy;
    const int was = before->policy.placements.front().xpu;
    options.wishes.forbids.emplace_back(app.xnodes.front().name, platform.xpus[at(was)].id);
    const Result<Answer> after = solve(app, platform, options);
    if (!after || after->outcome != Outcome::kPolicy) continue;  // it can run nowhere else
    EXPECT_EQ(after->moved, elsewhere(before->policy, after->policy)) << seed;
    ASSERT_FALSE(after->moved.empty()) << seed;
    EXPECT_EQ(after->moved.front(), 0) << seed;
    EXPECT_TRUE(check(app, platform, after->policy)) << seed;
    ++asked;
    moved += static_cast<int>(after->moved.size());
  }
  EXPECT_GE(asked, 10);
  EXPECT_GT(moved, asked) << "others moved, too";
}

TEST(KeysSolve, AHintNeedNotKnowAllXNodes) {
  solver::test::Dice dice(99);
  const AppSpec app = random_rated_app(dice, {});
  const Platform platform = random_rated_platform(dice);
  const Result<Answer> a = solve(app, platform, brief(300));
  ASSERT_TRUE(a);
  ASSERT_EQ(a->outcome, Outcome::kPolicy);
  Policy older = a->policy;
  older.placements.back() = {};
  Options options = brief(300);
  options.hint = &older;
  const Result<Answer> b = solve(app, platform, options);
  ASSERT_TRUE(b);
  ASSERT_EQ(b->outcome, Outcome::kPolicy);
  EXPECT_TRUE(check(app, platform, b->policy));
  for (Placement& placed : older.placements) placed = {};
  EXPECT_FALSE(solve(app, platform, options));
}

TEST(KeysSolve, AShortLimitHasAnAnswerToo) {
  int policies = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape = two_clocks(100);
    shape.least_period = 30;
    shape.most_period = 40;
    const AppSpec app = random_rated_app(dice, shape);
    Options options;
    options.time_limit_s = 0;
    const Result<Answer> answer = solve(app, random_rated_platform(dice), options);
    ASSERT_TRUE(answer);
    policies += answer->outcome == Outcome::kPolicy ? 1 : 0;
  }
  EXPECT_GT(policies, 10);
}

/// 4000 chains of five XNodes on `clocks` clocks, and 64 CPUs that all of them share.
AppSpec huge_app(int clocks) {
  constexpr int kChains = 4000, kLength = 5;
  constexpr int kPeriodsUs[] = {33'333, 50'000, 100'000, 20'000};
  solver::test::Dice dice(1);
  AppSpec app;
  app.name = "huge";
  for (int k = 1; k < clocks; ++k) app.clocks.push_back({"k" + std::to_string(k), 100});
  for (int c = 0; c < kChains; ++c) {
    const std::string name = std::to_string(c);
    const int period_us = kPeriodsUs[dice.roll(0, 3)];
    app.sources.push_back({.name = "s" + name, .period = {period_us, 1}, .clock = c % clocks});
    app.modules.push_back({"m" + name});
    for (int i = 0; i < kLength; ++i) {
      XNodeSpec xnode;
      xnode.name = "x" + name + "_" + std::to_string(i);
      xnode.module = "m" + name;
      xnode.wcet_us = {{"cpu", dice.roll(period_us / 2000, period_us * 3 / 2000)}};
      if (i == 0) xnode.sources = {c};
      app.xnodes.push_back(std::move(xnode));
      const int last = static_cast<int>(app.xnodes.size()) - 1;
      if (i > 0) app.edges.emplace_back(last - 1, last);
    }
    app.chains.push_back({"c" + name, c, static_cast<int>(app.xnodes.size()) - 1, 5 * period_us});
  }
  return app;
}

/// In CPU time, which a busy machine does not lengthen, of one thread.
TEST(KeysSolve, NoSizeBreaksTheTimeLimit) {
  Platform platform;
  platform.name = "many";
  for (int m = 0; m < 64; ++m)
    platform.xpus.push_back({.id = "cpu" + std::to_string(m), .type = "cpu", .preempt_us = 5});
  const auto cpu_s = [] {
    timespec time{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_nsec) * 1e-9;
  };
  for (const int clocks : {1, 2, 8}) {
    Options options;
    options.time_limit_s = 0.2;
    const double began = cpu_s();
    const Result<Answer> answer = solve(huge_app(clocks), platform, options);
    EXPECT_LT(cpu_s() - began, 1.3 * options.time_limit_s + 1) << clocks << " clocks";
    ASSERT_TRUE(answer) << answer.error().to_string();
  }
}

}  // namespace
}  // namespace xauto::solver::keys

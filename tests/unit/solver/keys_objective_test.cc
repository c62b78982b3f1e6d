// SPDX-License-Identifier: Apache-2.0
// What solve() minimises: the mix, the largest, the sum.
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "model/json.h"
#include "solver/generate.h"
#include "solver/keys/check.h"
#include "solver/keys/one_release.h"
#include "solver/keys/solve.h"

#include "../cases.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

TEST(KeysObjective, IsInPartsOfDeadlinesWhereThereAreAny) {
  AppSpec app;
  app.chains = {{"a", 0, 0, 100}, {"b", 0, 0, 40}, {"c", 0, 0, {}}};
  app.chains[1].weight = 3;
  const Totals parts = totals_of(app, {50, 10, 300});
  EXPECT_DOUBLE_EQ(parts.largest, 0.5);             // c has no deadline
  EXPECT_DOUBLE_EQ(parts.sum, 0.5 + 3 * 0.25 + 3);  // ... and counts by the largest one
  for (ChainSpec& chain : app.chains) chain.deadline_us.reset();
  const Totals us = totals_of(app, {50, 10, 300});
  EXPECT_DOUBLE_EQ(us.largest, 300);
  EXPECT_DOUBLE_EQ(us.sum, 50 + 30 + 300);
}

Figures figures(double largest, double sum) {
  Figures f;
  f.valid = true;
  f.largest = largest;
  f.sum = sum;
  return f;
}

TEST(KeysObjective, OrdersPolicies) {
  const Goal largest{true, false}, sum{true, true}, mix{true, true, 0.525};
  EXPECT_TRUE(largest.better(figures(0.5, 9), figures(0.6, 1)));
  EXPECT_TRUE(largest.better(figures(0.5, 1), figures(0.5, 9)));
  EXPECT_TRUE(sum.better(figures(0.9, 1), figures(0.5, 2)));
  EXPECT_TRUE(sum.better(figures(1.0, 9), figures(1.1, 1))) << "first of all no deadline is missed";
  EXPECT_FALSE((Goal{false, true}).better(figures(1.0, 9), figures(1.1, 1)))
      << "... that can be met";
  EXPECT_TRUE(mix.better(figures(0.52, 1), figures(0.5, 2)));
  EXPECT_TRUE(mix.better(figures(0.5, 2), figures(0.53, 1)));
  EXPECT_TRUE(mix.better(figures(0.6, 2), figures(0.7, 1))) << "nearer to the limit";
}

struct Counted {
  int apps = 0;
  double largest = 0, sum = 0;  ///< of all apps, in parts of the same app's by kLargest
};

/// Random apps of which each chain has a deadline that can be met, by all three objectives.
TEST(KeysObjective, TheMixIsNearTheLeastLargestAndBelowItsSum) {
  Counted mix, sum;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.max_components = 4;
    AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    for (ChainSpec& chain : app.chains) chain.deadline_us = 60 + 40 * dice.roll(0, 5);
    const auto solved = [&](Aim aim) {
      Options options = brief(1500);
      options.aim = aim;
      auto answer = solve(app, platform, options);
      EXPECT_TRUE(answer) << seed;
      return std::move(answer).value();
    };
    const Answer by_largest = solved(Aim::kLargest);
    if (by_largest.outcome != Outcome::kPolicy || by_largest.totals.largest > 1) continue;
    for (const Aim aim : {Aim::kMix, Aim::kSum}) {
      const Answer answer = solved(aim);
      ASSERT_EQ(answer.outcome, Outcome::kPolicy) << seed;
      EXPECT_TRUE(check(app, platform, answer.policy)) << seed;
      EXPECT_LE(answer.totals.largest, 1) << seed;
      EXPECT_LE(answer.bounds.largest, answer.totals.largest) << seed;
      EXPECT_LE(answer.bounds.sum, answer.totals.sum * (1 + 1e-12)) << seed;
      if (aim == Aim::kMix) {
        // To a microsecond, since what is claimed is rounded.
        EXPECT_LE(answer.totals.largest, kWithin * answer.least_largest + 1.0 / 60) << seed;
      }
      Counted& of = aim == Aim::kMix ? mix : sum;
      ++of.apps;
      of.largest += answer.totals.largest / by_largest.totals.largest;
      of.sum += answer.totals.sum / by_largest.totals.sum;
    }
  }
  ASSERT_GT(mix.apps, 20);
  EXPECT_LT(mix.largest, 1.03 * mix.apps);
  EXPECT_LT(mix.sum, 0.998 * mix.apps);
  EXPECT_LE(sum.sum, mix.sum * 1.002);
  EXPECT_GT(sum.largest, mix.largest);
}

TEST(KeysObjective, NoMixIsWorseThanItsHint) {
  int asked = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    solver::test::Dice dice(seed);
    RatedShape shape;
    shape.max_components = 4;
    AppSpec app = random_rated_app(dice, shape);
    const Platform platform = random_rated_platform(dice);
    for (ChainSpec& chain : app.chains) chain.deadline_us = 60 + 40 * dice.roll(0, 5);
    Options options = brief(1500);
    const auto before = solve(app, platform, options);
    ASSERT_TRUE(before) << seed;
    if (before->outcome != Outcome::kPolicy || before->totals.largest > 1) continue;
    ++asked;
    options.hint = &before->policy;
    options.seed = 9;
    for (const std::int64_t evaluations : {1, 40}) {
      options.max_evaluations = evaluations;
      const auto after = solve(app, platform, options);
      ASSERT_TRUE(after && after->outcome == Outcome::kPolicy) << seed;
      EXPECT_LE(after->totals.largest, 1) << seed;
      // Unless a largest was found that puts the hint above the limit.
      if (before->totals.largest <= kWithin * after->least_largest) {
        EXPECT_LE(after->totals.sum, before->totals.sum * (1 + 1e-12)) << seed;
      }
    }
  }
  EXPECT_GT(asked, 15);
}

TEST(KeysObjective, TheSumDoesNotForgetDeadlines) {
  // By the sum alone the short chains would go first, and the long one, which is urgent, late.
  AppSpec app;
  app.name = "urgent";
  app.sources = {{"s", {100}}};
  app.modules = {{"m"}};
  app.xnodes.push_back({"long", "m", {{"cpu", 40}}, {0}});
  app.chains.push_back({"long", 0, 0, 45});
  for (int i = 1; i <= 4; ++i) {
    const std::string name = "short" + std::to_string(i);
    app.modules.push_back({name});
    app.xnodes.push_back({name, name, {{"cpu", 5}}, {0}});
    app.chains.push_back({name, 0, i, 80});
  }
  const Platform platform{"one", {{"cpu0", "cpu"}}};
  for (const Aim aim : {Aim::kMix, Aim::kLargest, Aim::kSum}) {
    Options options;
    options.aim = aim;
    options.max_evaluations = 600;
    const auto answer = solve(app, platform, options);
    ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
    EXPECT_LE(answer->policy.chains[0].worst_case_us, 45) << static_cast<int>(aim);
  }
  // Where it cannot be met, the sum is what was asked for.
  app.chains[0].deadline_us = 30;
  Options options;
  options.aim = Aim::kSum;
  options.max_evaluations = 600;
  const auto answer = solve(app, platform, options);
  ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
  EXPECT_GT(answer->bounds.largest, 1);
  const Totals is = answer->totals;
  EXPECT_NEAR(is.sum, (5 + 10 + 15 + 20) / 80.0 + 60 / 30.0, 0.2);
}

/// What is proven of the largest of one chain is proven of that chain, and its claim says so.
TEST(KeysObjective, TheProofOfTheOnlyChainIsInItsClaim) {
  GenerateOptions synthetic;
  synthetic.nodes = 40;
  synthetic.seed = 7002;  // its plan is proven in a second, and by no bound of its chain alone
  const AppSpec app = *parse_app(to_json(*generate(synthetic)), "app.json");
  ASSERT_EQ(app.chains.size(), 1u);
  Options options;
  options.aim = Aim::kLargest;
  options.time_limit_s = 10;
  const auto answer = solve(app, *Platform::builtin("small"), options);
  ASSERT_TRUE(answer && answer->outcome == Outcome::kPolicy);
  const ChainClaim& claim = answer->policy.chains[0];
  EXPECT_EQ(claim.lower_bound_us, std::llround(answer->bounds.largest));
  EXPECT_EQ(claim.optimal, claim.worst_case_us == claim.lower_bound_us);
}

/// With the deadline as a wish of its own the plan was so much longer that releases met: 626 ms back to back where 246
/// are enough.
TEST(KeysObjective, OneDeadlineOfAllMakesNoOtherPlan) {
  GenerateOptions synthetic;
  synthetic.nodes = 60;
  synthetic.seed = 8003;
  AppSpec app = *parse_app(to_json(*generate(synthetic)), "app.json");
  app.one_at_a_time = false;
  app.sources[0].period = {250'000};
  Platform platform = *Platform::builtin("small");
  for (Xpu& xpu : platform.xpus) xpu.preemptive = xpu.type == "cpu";
  std::vector<std::int64_t> ends;
  for (const std::optional<std::int64_t> deadline_us :
       {std::optional<std::int64_t>(), std::optional<std::int64_t>(253'000)}) {
    app.chains[0].deadline_us = deadline_us;
    SolveOptions options;
    options.max_evaluations = 20'000;
    const auto plan =
        plan_of_one_release(app, platform, *Problem::create(app, platform, {}), options);
    ASSERT_TRUE(plan) << plan.error().to_string();
    std::int64_t end = 0;
    for (const Placement& placed : plan->policies.front().placements)
      end = std::max(end, placed.key_us[0]);
    ends.push_back(end);
  }
  EXPECT_EQ(ends[0], ends[1]);
}

/// Suspending costs something here: the keys of a plan are a certificate as they are, by code of its own,
/// and every chain ends when the plan says.
TEST(KeysObjective, APlanThatSuspendsIsCertifiedAsItIs) {
  const int apps = xauto::test::cases(20, 60);
  int held = 0;
  for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(apps); ++seed) {
    GenerateOptions synthetic;
    synthetic.nodes = 18;
    synthetic.seed = seed;
    const AppSpec app = *parse_app(to_json(*generate(synthetic)), "app.json");
    Platform platform = *Platform::builtin("small");
    for (Xpu& xpu : platform.xpus) xpu.preempt_us = 300;
    SolveOptions options;
    options.max_evaluations = 20'000;
    options.time_limit_s = 1e9;
    auto plan = plan_of_one_release(app, platform, *Problem::create(app, platform, {}), options);
    ASSERT_TRUE(plan) << plan.error().to_string();
    for (Policy& policy : plan->policies) {
      for (const Placement& placed : policy.placements) held += placed.hold_us.empty() ? 0 : 1;
      for (const ChainSpec& chain : app.chains)
        policy.chains.push_back({chain.name, policy.placements[at(chain.to)].key_us.front()});
      const auto checked = check(app, platform, policy);
      EXPECT_TRUE(checked) << seed << ": " << checked.error().to_string();
    }
  }
  EXPECT_GT(3 * held, 2 * apps);
}

/// ... of worst case / deadline, of the Driving Case at its rates; `gpu`: its LiDAR's net is to be there.
double driving_sum(bool gpu, std::uint64_t seed) {
  const AppSpec app = *load_app(XAUTO_SOURCE_DIR "/examples/driving/rates.json");
  Options options = brief(20'000);
  options.seed = seed;
  if (gpu) options.wishes.pins.push_back({"ld.infer", "gpu0"});
  const auto answer = solve(app, *Platform::builtin("small"), options);
  EXPECT_TRUE(answer) << answer.error().to_string();
  double sum = 0;
  for (std::size_t c = 0; c < app.chains.size(); ++c)
    sum += static_cast<double>(answer->policy.chains[c].worst_case_us) /
           static_cast<double>(*app.chains[c].deadline_us);
  return sum;
}

/// The net moved to the GPU alone is worse, until three others have left the GPU: what is found with it there may be
/// found without being told. Before there were detours no seed of eight came nearer than 4.8 %.
TEST(KeysObjective, AnAssignmentThatIsFarFromTheFirstIsFound) {
  double told = 9, untold = 9;
  for (const std::uint64_t seed : {2, 4, 7}) {
    told = std::min(told, driving_sum(true, seed));
    untold = std::min(untold, driving_sum(false, seed));
  }
  EXPECT_LE(untold, 1.03 * told);
}

}  // namespace
}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Where nothing can be certified there is a policy all the same, and what is suggested is true.
#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/sustain.h"
#include "solver/keys/uncertified.h"

#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// Three rates on one GPU, of which WCETs take 118 %, and what is usual 92 %.
AppSpec three_rates() {
  AppSpec app;
  app.name = "three";
  const struct {
    const char* name;
    std::int64_t period_us, wcet_us, typical_us;
  } rates[] = {{"camera", 10'000, 4800, 3900},
               {"radar", 50'000, 18'000, 14'000},
               {"lidar", 100'000, 34'000, 25'000}};
  for (const auto& rate : rates) {
    const int s = static_cast<int>(app.sources.size());
    app.sources.push_back({rate.name, {rate.period_us, 1}});
    for (const char* stage : {".pre", ".infer"}) {
      XNodeSpec x;
      x.name = std::string(rate.name) + stage;
      x.module = rate.name;
      const bool infers = stage == std::string(".infer");
      x.wcet_us = {{infers ? "gpu" : "cpu", infers ? rate.wcet_us : 1000}};
      if (infers) x.typical_us = {{"gpu", rate.typical_us}};
      if (!infers) x.sources = {s};
      app.xnodes.push_back(x);
    }
    app.modules.push_back({rate.name, 2});
    app.edges.emplace_back(2 * s, 2 * s + 1);
    app.chains.push_back({rate.name, s, 2 * s + 1, 2 * rate.period_us});
  }
  return app;
}

Platform one_gpu() {
  Platform platform;
  platform.name = "one";
  platform.xpus = {{"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 100}};
  return platform;
}

TEST(KeysUncertified, AnOverloadedAppHasAPolicyWithoutClaimsThatIsInTimeAtUsualTimes) {
  const AppSpec app = three_rates();
  const Platform platform = one_gpu();
  const auto refused = solve(app, platform, brief(500));
  ASSERT_TRUE(refused);
  ASSERT_EQ(refused->outcome, Outcome::kUnsustainable);
  const auto found = least_late(app, platform, brief(4000));
  ASSERT_TRUE(found) << found.error().to_string();
  EXPECT_FALSE(found->policy.certified);
  EXPECT_TRUE(found->policy.chains.empty());
  const Status sane = validate(found->policy, app, platform);
  EXPECT_TRUE(sane) << sane.error().to_string();
  EXPECT_TRUE(check_places(app, platform, found->policy));
  EXPECT_FALSE(check(app, platform, found->policy)) << "nothing follows of what claims nothing";
  ASSERT_TRUE(found->played);
  for (const PlayedChain& chain : found->played->chains) {
    EXPECT_GT(chain.releases, 0) << chain.name;
    const auto& spec = *std::ranges::find(app.chains, chain.name, &ChainSpec::name);
    EXPECT_LE(chain.longest_us, static_cast<double>(*spec.deadline_us)) << chain.name;
  }
  EXPECT_NEAR(found->load[1].at_wcets, 1.18, 1e-9);
  EXPECT_NEAR(found->load[1].usual, 0.92, 1e-9);
}

TEST(KeysUncertified, WithTheSuggestedMarginTheSameAppIsCertified) {
  const AppSpec app = three_rates();
  const Platform platform = one_gpu();
  const auto found = least_late(app, platform, brief(4000));
  ASSERT_TRUE(found) << found.error().to_string();
  ASSERT_TRUE(found->certified_pct && found->overloaded_pct);
  EXPECT_EQ(found->overloaded_pct, 85) << "100 / 1.18 is 84.7";
  EXPECT_LT(*found->certified_pct, *found->overloaded_pct);
  EXPECT_GE(*found->certified_pct, 70);
  const AppSpec shorter = at_percent(app, *found->certified_pct);
  const auto answer = solve(shorter, platform, brief(4000));
  ASSERT_TRUE(answer);
  ASSERT_EQ(answer->outcome, Outcome::kPolicy);
  EXPECT_TRUE(check(shorter, platform, answer->policy));
  ASSERT_TRUE(found->in_time_pct);
  EXPECT_LE(*found->in_time_pct, *found->certified_pct);
  const auto in_time = certifies(at_percent(app, *found->in_time_pct), platform, brief(4000), true);
  ASSERT_TRUE(in_time && in_time->outcome == Outcome::kPolicy);
  EXPECT_FALSE(in_time->late);
  const auto over = Problem::create(at_percent(app, *found->overloaded_pct), platform);
  ASSERT_TRUE(over);
  EXPECT_TRUE(prove_overload(*over));
}

TEST(KeysUncertified, ThereIsAPolicyForWhateverIsNotCertified) {
  RatedShape crowded;
  crowded.least_period = 3;
  crowded.most_period = 9;
  crowded.clocks = 2;
  crowded.ppm = 100;
  crowded.urgent = true;
  int refused = 0, in_no_time = 0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    solver::test::Dice dice(seed);
    const AppSpec app = random_rated_app(dice, crowded);
    const Platform platform = random_rated_platform(dice);
    const auto answer = solve(app, platform, brief(60));
    if (!answer || answer->outcome == Outcome::kPolicy) continue;
    ++refused;
    for (const bool no_time : {false, true}) {
      Options options = brief(80);
      if (no_time) options.time_limit_s = 0;
      const auto found = least_late(app, platform, options);
      ASSERT_TRUE(found) << seed << ": " << found.error().to_string();
      const Status sane = validate(found->policy, app, platform);
      EXPECT_TRUE(sane) << seed << ": " << sane.error().to_string();
      EXPECT_TRUE(check_places(app, platform, found->policy)) << seed;
      EXPECT_FALSE(found->certified_pct && found->overloaded_pct &&
                   *found->certified_pct >= *found->overloaded_pct)
          << seed;
      in_no_time += no_time ? 1 : 0;
    }
  }
  EXPECT_GT(refused, 12);
  EXPECT_EQ(in_no_time, refused);
}

}  // namespace
}  // namespace xauto::solver::keys

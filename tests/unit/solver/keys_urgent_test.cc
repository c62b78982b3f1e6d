// SPDX-License-Identifier: Apache-2.0
// Urgent releases: what solve() and check() claim of them, against two simulators that share no code
// with either (keys_naive.h, tests/attack), and against all patterns of tiny apps.
#include <gtest/gtest.h>

#include "model/periodic.h"
#include "solver/keys/check.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"

#include "attack/attack.h"
#include "keys_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

/// A camera and a slower lane keeper share one CPU; the camera's releases may be urgent.
AppSpec two_chains(std::int64_t by_us = 2000, std::int64_t every_us = 100'000) {
  AppSpec app;
  app.name = "urgent";
  app.sources = {{"camera", {10'000}}, {"lane", {20'000}}};
  app.sources[0].urgent = {by_us, every_us};
  app.xnodes = {{"cam", "m0", {{"cpu", 2000}}, {0}}, {"lane", "m1", {{"cpu", 5000}}, {1}}};
  complete_modules(app);
  complete_chains(app);
  return app;
}

Platform one_cpu() {
  return {"one", {{"cpu0", "cpu", true, 0}}};
}

Answer solved(const AppSpec& app, const Platform& platform) {
  auto answer = solve(app, platform, brief(2000));
  EXPECT_TRUE(answer && answer->outcome == Outcome::kPolicy)
      << (answer ? "no policy" : answer.error().to_string());
  return answer ? *answer : Answer{};
}

TEST(KeysUrgent, APolicySaysHowMuchSoonerAnUrgentReleaseIs) {
  const AppSpec app = two_chains();
  const Answer answer = solved(app, one_cpu());
  ASSERT_EQ(answer.policy.chains.size(), 2u);
  const ChainClaim& camera = answer.policy.chains[0];
  ASSERT_TRUE(camera.urgent_worst_case_us);
  EXPECT_EQ(*camera.urgent_worst_case_us, camera.worst_case_us - 2000);  // no sample: by the amount
  EXPECT_FALSE(answer.policy.chains[1].urgent_worst_case_us);
  // The window of an urgent job begins with the message, and has to hold the WCET.
  EXPECT_GE(answer.policy.placements[0].key_us[0], 2000 + 2000);
  const auto report = check(app, one_cpu(), answer.policy);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->xpus[0].kind, "demand bound");
  EXPECT_EQ(report->chains[0].urgent_us, camera.urgent_worst_case_us);
}

TEST(KeysUrgent, WhatTheOthersPayIsTheUrgentWork) {
  AppSpec app = two_chains(2000, 10'000'000);
  // By hand: an ordinary and an urgent camera job, back to back in any phase, beside the lane's job.
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {4000}}, {0, {9000}}};
  policy.chains = {{"camera -> cam", 4000, 0, false, 2000}, {"lane -> lane", 9000, 0, false}};
  ASSERT_TRUE(check(app, one_cpu(), policy)) << check(app, one_cpu(), policy).error().to_string();
  policy.placements[1].key_us = {8999};
  policy.chains[1].worst_case_us = 8999;
  EXPECT_FALSE(check(app, one_cpu(), policy)) << "2000 + 2000 + 5000 do not fit into 8999";
  // Without the twin they would.
  app.sources[0].urgent.reset();
  policy.chains[0].urgent_worst_case_us.reset();
  policy.app_hash = app.hash();
  EXPECT_TRUE(check(app, one_cpu(), policy));
}

TEST(KeysUrgent, ChecksRefuseWhatUrgencyBreaks) {
  const AppSpec app = two_chains();
  Policy policy = solved(app, one_cpu()).policy;
  const auto refusal = [&](const AppSpec& of, Policy changed) {
    changed.app_hash = of.hash();
    const auto report = check(of, one_cpu(), changed);
    return report ? std::string() : report.error().to_string();
  };
  EXPECT_EQ(refusal(app, policy), "");
  Policy lies = policy;
  *lies.chains[0].urgent_worst_case_us -= 1;
  EXPECT_NE(refusal(app, lies).find("urgent_worst_case_us is"), std::string::npos);
  lies.chains[0].urgent_worst_case_us.reset();
  EXPECT_NE(refusal(app, lies).find("no urgent_worst_case_us"), std::string::npos);
  // Shifted by more than the window has room for: key - by < WCET.
  AppSpec more = two_chains(policy.placements[0].key_us[0] - 2000 + 1);
  EXPECT_NE(refusal(more, policy).find("urgent"), std::string::npos);
  EXPECT_NE(refusal(more, policy).find("takes 2000 us"), std::string::npos);
}

TEST(KeysUrgent, AnUrgentReleaseDoesNotOvertakeTheOneBefore) {
  // Keys 12000 and then 4000 a period of 10000 later: an urgent one is earlier by at most 2000.
  AppSpec app = two_chains(2000);
  app.sources[1].period = {20'000};
  Policy policy;
  policy.app = app.name;
  policy.placements = {{0, {12'000, 4000}}, {0, {19'000}}};
  app.modules[0].max_in_flight = 2;
  policy.chains = {{"camera -> cam", 19'000, 0, false, 19'000}, {"lane -> lane", 19'000, 0, false}};
  policy.app_hash = app.hash();
  EXPECT_TRUE(check(app, one_cpu(), policy)) << check(app, one_cpu(), policy).error().to_string();
  app.sources[0].urgent->by_us = 2001;
  app.xnodes[0].wcet_us["cpu"] = 1000;
  policy.app_hash = app.hash();
  const auto report = check(app, one_cpu(), policy);
  ASSERT_FALSE(report);
  EXPECT_NE(report.error().to_string().find("may fall before"), std::string::npos)
      << report.error().to_string();
}

TEST(KeysUrgent, UrgencyLoadsNothingForLong) {
  // 20 % and 70 %: with every urgent job beside an ordinary one it would be 110 %.
  AppSpec app = two_chains(2000, 10'000);
  app.xnodes[1].wcet_us["cpu"] = 14'000;
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.placements = {{0, {4000}}, {0, {20'000}}};
  policy.chains = {{"camera -> cam", 4000, 0, false, 2000}, {"lane -> lane", 20'000, 0, false}};
  const auto report = check(app, one_cpu(), policy);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_NEAR(report->xpus[0].load, 0.9, 1e-9);
  EXPECT_EQ(report->xpus[0].slack_us, 0);  // 2 + 1 camera jobs and the lane's in 20 ms
  const auto found = attack::attack(app, one_cpu(), policy, {200'000, 1});
  EXPECT_EQ(found.late + found.chain, "");
  app.xnodes[1].wcet_us["cpu"] = 12'000;
  solved(app, one_cpu());
}

struct Tried {
  int policies = 0;
  std::int64_t jobs = 0;
};

/// Modules mark in place of drivers, the first that can. False: none can.
bool marked_by_modules(AppSpec& app) {
  bool any = false;
  for (SourceSpec& source : app.sources) {
    if (!source.urgent) continue;
    for (const XNodeSpec& xnode : app.xnodes) {
      source.urgent->marked_by = xnode.module;
      if (validate(app)) break;
      source.urgent->marked_by.clear();
    }
    any = any || !source.urgent->marked_by.empty();
  }
  return any;
}

/// Solves random apps; `told` is what the solver is told instead of the truth.
std::string attack_random(const RatedShape& shape, int apps, int plays, std::uint64_t seed,
                          Tried& tried, const std::function<void(AppSpec&)>& blind = {},
                          bool by_modules = false) {
  for (int a = 0; a < apps; ++a) {
    solver::test::Dice dice(seed * 100'003 + static_cast<std::uint64_t>(a));
    AppSpec app = random_rated_app(dice, shape);
    if (by_modules && !marked_by_modules(app)) continue;
    const Platform platform = random_rated_platform(dice);
    if (std::none_of(app.sources.begin(), app.sources.end(),
                     [](const SourceSpec& s) { return s.urgent.has_value(); }))
      continue;
    EXPECT_TRUE(validate(app)) << validate(app).error().to_string();
    AppSpec told = app;
    if (blind) blind(told);
    auto answer = solve(told, platform, brief(150));
    if (!answer) return answer.error().to_string();
    if (answer->outcome != Outcome::kPolicy) continue;
    ++tried.policies;
    const auto checked = check(told, platform, answer->policy);
    if (!checked) return "app " + std::to_string(a) + ", the check: " + checked.error().to_string();
    for (std::size_t c = 0; c < checked->chains.size(); ++c) {
      EXPECT_LE(checked->chains[c].derived_us, answer->policy.chains[c].worst_case_us);
      EXPECT_EQ(checked->chains[c].urgent_us.has_value(),
                checked->chains[c].claimed_urgent_us.has_value());
    }
    const std::string broken = play_naively(app, platform, answer->policy, plays, 14, tried.jobs);
    if (!broken.empty()) return "app " + std::to_string(a) + " " + broken;
    const auto found = attack::attack(app, platform, answer->policy, {10'000, seed});
    tried.jobs += found.jobs;
    if (found.broken()) return "app " + std::to_string(a) + ", attack: " + found.late + found.chain;
  }
  return {};
}

RatedShape urgent_shape(int clocks, int ppm) {
  RatedShape shape;
  shape.urgent = true;
  shape.clocks = clocks;
  shape.ppm = ppm;
  shape.max_components = clocks > 1 ? 3 : 2;
  shape.least_period = 14;
  return shape;
}

TEST(KeysUrgent, NoPatternOfUrgentReleasesBreaksAPolicy) {
  Tried tried;
  EXPECT_EQ(attack_random(urgent_shape(1, 0), 90, 12, 21, tried), "");
  EXPECT_EQ(attack_random(urgent_shape(2, 100), 40, 12, 22, tried), "");
  EXPECT_EQ(attack_random(urgent_shape(2, 20'000), 40, 12, 23, tried), "");
  RatedShape pipeline = urgent_shape(1, 0);
  pipeline.max_components = 1;
  pipeline.max_nodes = 6;
  pipeline.least_period = 6;
  pipeline.most_period = 10;
  EXPECT_EQ(attack_random(pipeline, 90, 12, 24, tried), "");
  EXPECT_GT(tried.policies, 60);
  EXPECT_GT(tried.jobs, 500'000);
}

TEST(KeysUrgent, TheAttackFindsUrgencyThatTheSolverWasNotTold) {
  Tried tried;
  EXPECT_NE(attack_random(urgent_shape(1, 0), 60, 18, 31, tried,
                          [](AppSpec& told) {
                            for (SourceSpec& s : told.sources) s.urgent.reset();
                          }),
            "");
}

TEST(KeysUrgent, TheAttackFindsUrgencyOfALargerAmount) {
  Tried tried;
  EXPECT_NE(attack_random(urgent_shape(1, 0), 60, 18, 32, tried,
                          [](AppSpec& told) {
                            for (SourceSpec& s : told.sources)
                              if (s.urgent) s.urgent->by_us = 1;
                          }),
            "");
}

/// camera -> look (2 ms) -> act (1 ms), beside a lane keeper. What look sees makes act sooner, not itself.
AppSpec marked_by_look(std::int64_t by_us = 3000) {
  AppSpec app = two_chains(by_us);
  app.sources[0].urgent->marked_by = "look";
  app.xnodes = {{"cam", "look", {{"cpu", 2000}}, {0}},
                {"lane", "m1", {{"cpu", 5000}}, {1}},
                {"act", "m2", {{"cpu", 1000}}}};
  app.edges = {{0, 2}};
  app.modules.clear();
  app.chains.clear();
  complete_modules(app);
  complete_chains(app);
  return app;
}

TEST(KeysUrgent, WhatAModuleMarksIsSoonerForThoseBehindIt) {
  AppSpec app = marked_by_look();
  ASSERT_TRUE(validate(app)) << validate(app).error().to_string();
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  // By hand: act is due at 8 ms, urgent at 5, and waits for what is there by 4.
  policy.placements = {{0, {4000}}, {0, {12'000}}, {0, {8000}}};
  policy.chains = {{"camera -> act", 8000, 0, false, 5000}, {"lane -> lane", 12'000, 0, false}};
  const auto refusal = [&]() -> std::string {
    policy.app_hash = app.hash();
    const auto report = check(app, one_cpu(), policy);
    return report ? "" : report.error().to_string();
  };
  EXPECT_EQ(refusal(), "");
  // 1 ms in what is left between the key of cam, which is no sooner, and act's own.
  app.sources[0].urgent->by_us = 3001;
  policy.chains[0].urgent_worst_case_us = 4999;
  EXPECT_NE(refusal().find("takes 1000 us"), std::string::npos) << refusal();
  // If the driver marked, cam would be sooner, too.
  app.sources[0].urgent->marked_by.clear();
  app.sources[0].urgent->by_us = 2000;
  policy.chains[0].urgent_worst_case_us = 6000;
  EXPECT_EQ(refusal(), "");
}

TEST(KeysUrgent, NoPatternOfWhatModulesMarkBreaksAPolicy) {
  RatedShape shape = urgent_shape(1, 0);
  shape.max_nodes = 6;
  Tried tried;
  EXPECT_EQ(attack_random(shape, 120, 12, 41, tried, {}, true), "");
  shape.clocks = 2;
  shape.ppm = 100;
  shape.max_components = 3;
  EXPECT_EQ(attack_random(shape, 60, 12, 42, tried, {}, true), "");
  EXPECT_GT(tried.policies, 30);
}

/// cam ends by its key, 4 ms, behind the lane keeper; act has 1 ms more, and 1 ms less where look marks.
TEST(KeysUrgent, TheAttackPlaysWhatModulesMark) {
  AppSpec app = marked_by_look(2000);
  app.xnodes[1].wcet_us["cpu"] = 2000;
  Policy policy;
  policy.app = app.name;
  policy.placements = {{0, {4000}}, {0, {3900}}, {0, {5000}}};
  policy.chains = {{"camera -> act", 5000, 0, false, 3000}, {"lane -> lane", 3900, 0, false}};
  policy.app_hash = app.hash();
  EXPECT_FALSE(check(app, one_cpu(), policy));
  const auto found = attack::attack(app, one_cpu(), policy, {20'000, 1});
  EXPECT_NE(found.late.find("act"), std::string::npos) << found.late << found.chain;
  EXPECT_EQ(found.late.find("cam"), std::string::npos) << found.late;
  app.sources[0].urgent.reset();
  policy.chains[0].urgent_worst_case_us.reset();
  policy.app_hash = app.hash();
  EXPECT_TRUE(check(app, one_cpu(), policy)) << check(app, one_cpu(), policy).error().to_string();
  EXPECT_FALSE(attack::attack(app, one_cpu(), policy, {20'000, 1}).broken());
}

/// All patterns of urgent releases over twelve releases, of apps of two and three jobs that take
/// their WCETs: the schedule is exact.
TEST(KeysUrgent, AllPatternsOfTinyApps) {
  int policies = 0, patterns = 0;
  for (std::uint64_t a = 0; a < 24; ++a) {
    solver::test::Dice dice(7'000'003 + a);
    RatedShape shape = urgent_shape(1, 0);
    shape.max_nodes = 2;
    shape.jitter = shape.offsets = false;
    AppSpec app = random_rated_app(dice, shape);
    if (app.xnodes.size() < 2 || app.xnodes.size() > 3) continue;
    if (!app.sources[0].urgent) app.sources[0].urgent = {3, app.sources[0].period.num * 2};
    const Platform platform = random_rated_platform(dice);
    const auto answer = solve(app, platform, brief(150));
    ASSERT_TRUE(answer) << answer.error().to_string();
    if (answer->outcome != Outcome::kPolicy) continue;
    ++policies;
    for (std::uint32_t pattern = 0; pattern < (1u << 8); ++pattern, ++patterns) {
      Disturbance how;
      how.worst_times = true;
      how.urgent = pattern << 2;  // 0 and 1 say something else
      NaiveRun run(app, platform, answer->policy, 12, how);
      ASSERT_EQ(run.run(), "") << "app " << a << " pattern " << how.urgent;
    }
  }
  EXPECT_GE(policies, 5);
}

TEST(KeysUrgent, PlayedUrgentReleasesStayWithinBothWorstCases) {
  const AppSpec app = two_chains(3000, 20'000);
  const Answer answer = solved(app, one_cpu());
  PlayOptions options;
  options.urgent = options.random_times = true;
  const auto played = play(app, one_cpu(), answer.policy, options);
  ASSERT_TRUE(played);
  EXPECT_EQ(played->late, 0);
  EXPECT_GT(played->chains[0].urgent, 200);
  for (const PlayedChain& chain : played->chains) EXPECT_FALSE(chain.exceeded()) << chain.name;
}

}  // namespace
}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Which scenario counts. Random runs are judged by conditions written here from the words of
// docs/modes.md, not by the code's own arithmetic: times, floors and dwells are kept a second time.
#include "tables/scenario_choice.h"

#include <algorithm>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "model/periodic.h"

#include "tests/unit/tables_of.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kMilli = 1'000'000;
constexpr std::int64_t kDwell = 100 * kMilli;

/// XNode a can run on both types, b on the CPU alone.
AppSpec two_xnodes() {
  AppSpec app;
  app.name = "two";
  app.one_at_a_time = true;
  app.sources.push_back({"camera", kNoRate});
  app.xnodes.push_back({"a", "m", {{"cpu", 4000}, {"gpu", 1000}}, {0}});
  app.xnodes.push_back({"b", "m", {{"cpu", 1000}}});
  app.edges.emplace_back(0, 1);
  complete_modules(app);
  complete_chains(app);
  return app;
}

Platform two_xpus() {
  Platform platform;
  platform.name = "here";
  platform.xpus.push_back({"cpu0", "cpu"});
  platform.xpus.push_back({"gpu0", "gpu"});
  return platform;
}

constexpr int kNominal = 0, kHalfGpu = 1, kHalfCpu = 2, kHalfBoth = 3, kNoGpu = 4;

/// a is on the GPU, unless that is at most half as fast, or lost.
Tables five_scenarios() {
  Tables tables;
  tables.app = "two";
  tables.app_hash = two_xnodes().hash();
  Scenario half_gpu{"half gpu"}, half_cpu{"half cpu"}, half_both{"half both"}, no_gpu{"no gpu"};
  half_gpu.wcet_scale_pct["gpu"] = 200;
  half_cpu.wcet_scale_pct["cpu"] = 200;
  half_both.wcet_scale_pct = {{"gpu", 200}, {"cpu", 200}};
  no_gpu.lost = {"gpu0"};
  tables.scenarios = {Scenario{"nominal"}, half_gpu, half_cpu, half_both, no_gpu};
  const AppSpec app = two_xnodes();
  tables.tables = {test::table_of(app, "gpu", {1, 0}, {2000, 4000}),
                   test::table_of(app, "cpu", {0, 0}, {4000, 5000})};
  for (const int table : {0, 0, 0, 0, 1}) test::serve(tables, app, table);
  for (const auto& [s, us] : {std::pair(0, 2000), {1, 3000}, {2, 3000}})
    tables.serves[static_cast<std::size_t>(s)].chain_worst_us = {us};
  set_figures(tables, app);
  return tables;
}

class ChoiceTest : public ::testing::Test {
 protected:
  ScenarioChoice make() {
    return ScenarioChoice(app_, platform_, tables_,
                          [](const std::string&, std::int64_t us) { return us * 1000; },
                          {kDwell, 0});
  }
  AppSpec app_ = two_xnodes();
  Platform platform_ = two_xpus();
  Tables tables_ = five_scenarios();
};

TEST_F(ChoiceTest, TheFixtureIsValid) {
  EXPECT_TRUE(validate(tables_, app_, platform_));
}

TEST_F(ChoiceTest, BeginsWithTheFirstAndStaysWhileJobsKeepTheirTimes) {
  ScenarioChoice choice = make();
  for (std::int64_t t = 0; t < 10 * kDwell; t += 10 * kMilli) {
    choice.saw(choice.now().table, 0, kMilli);
    EXPECT_FALSE(choice.decide(t));
  }
  EXPECT_EQ(choice.now().scenario, kNominal);
  EXPECT_EQ(choice.now().why, Why::kStart);
}

TEST_F(ChoiceTest, AJobThatIsTooLongEscalatesToTheLeastThatCoversIt) {
  ScenarioChoice choice = make();
  choice.saw(0, 0, kMilli + 1);
  EXPECT_TRUE(choice.decide(0));
  EXPECT_EQ(choice.now().scenario, kHalfGpu);
  EXPECT_EQ(choice.now().why, Why::kOverrun);
  EXPECT_EQ(choice.now().xnode, 0);
  EXPECT_EQ(choice.now().saw_ns, kMilli + 1);
  EXPECT_EQ(choice.now().allowed_ns, kMilli);
  // What held before still holds: not "half cpu", which forgets the GPU.
  choice.saw(0, 1, 2 * kMilli);
  EXPECT_TRUE(choice.decide(kMilli));
  EXPECT_EQ(choice.now().scenario, kHalfBoth);
}

/// Beside the nominal scenario and half of the GPU: a third of it, where a runs as a variant that takes
/// 0.4 of its time, so that the worst case is the least of all.
class LossTest : public ChoiceTest {
 protected:
  static constexpr int kThirdGpu = 2;
  void SetUp() override {
    app_.xnodes[0].variants = {{"small", 50, {{"gpu", 400}}}};
    tables_.app_hash = app_.hash();
    Scenario third{"a third", {{"gpu", 300}}};
    third.degraded = true;
    tables_.scenarios = {tables_.scenarios[kNominal], tables_.scenarios[kHalfGpu], third};
    tables_.tables = {test::table_of(app_, "gpu", {1, 0}, {2000, 3000}),
                      test::table_of(app_, "small", {1, 0}, {1200, 2200}, {{0, -1}, {}})};
    tables_.serves.clear();
    for (const int table : {0, 0, 1}) test::serve(tables_, app_, table);
    tables_.serves[0].chain_worst_us = {2000};
    tables_.serves[2].chain_worst_us = {1600};
    set_figures(tables_, app_);
    ASSERT_TRUE(validate(tables_, app_, platform_))
        << validate(tables_, app_, platform_).error().to_string();
  }
};

TEST_F(LossTest, NothingIsLostForAShorterWorstCase) {
  ScenarioChoice choice = make();
  for (std::int64_t t = 0; t < 5 * kDwell; t += 10 * kMilli) EXPECT_FALSE(choice.decide(t));
  choice.saw(0, 0, 3 * kMilli / 2);
  EXPECT_TRUE(choice.decide(5 * kDwell));
  EXPECT_EQ(choice.now().scenario, kHalfGpu) << "both cover it, and here nothing is lost";
  choice.saw(0, 0, 5 * kMilli / 2);
  EXPECT_TRUE(choice.decide(5 * kDwell + 1));
  EXPECT_EQ(choice.now().scenario, kThirdGpu);
  EXPECT_EQ(choice.now().table, 1);
}

TEST_F(LossTest, OutsideOfEveryScenarioMostIsLost) {
  for (const std::int64_t worst_us : {1600, 3000}) {  // 3000: of keys, all may have one
    for (Served& served : tables_.serves) served.worst_case_us = worst_us;
    ScenarioChoice choice = make();
    choice.saw(0, 1, 3 * kMilli);  // b takes 1 ms in all of them
    EXPECT_TRUE(choice.decide(0));
    EXPECT_EQ(choice.now().scenario, kThirdGpu);
    EXPECT_EQ(choice.now().table, 1);
    EXPECT_EQ(choice.now().why, Why::kOutside);
    EXPECT_EQ(choice.now().xnode, 1);
    choice.saw(1, 0, 2 * kMilli);
    const std::vector<Passing> jobs = choice.passing(kThirdGpu);
    ASSERT_EQ(jobs.size(), 2u) << "each XNode is told";
    EXPECT_EQ(jobs[0].xnode, 0);
    EXPECT_EQ(jobs[0].saw_ns, 2 * kMilli);
    EXPECT_EQ(jobs[0].allowed_ns, 1'200'000);
    EXPECT_EQ(jobs[1].xnode, 1);
    EXPECT_EQ(jobs[1].allowed_ns, kMilli);
  }
}

TEST_F(LossTest, ATrialThatEndsOutsideComesLaterToo) {
  ScenarioChoice choice = make();
  std::vector<std::int64_t> outsides;
  for (std::int64_t t = 0; outsides.size() < 5; t += kMilli) {
    ASSERT_LT(t, 1000 * kDwell);
    // Where b has to wait for nobody it is in time.
    choice.saw(choice.now().table, 1, choice.now().table == 0 ? 3 * kMilli : kMilli / 2);
    if (choice.decide(t) && choice.now().why == Why::kOutside) outsides.push_back(t);
  }
  for (std::size_t i = 1; i < outsides.size(); ++i)
    EXPECT_GE(outsides[i] - outsides[i - 1], kDwell << i) << i;
}

TEST_F(LossTest, AVariantIsHeldAgainstItsOwnWcet) {
  ScenarioChoice choice = make();
  choice.ask(kThirdGpu);
  ASSERT_TRUE(choice.decide(0));
  choice.ask(-1);
  choice.saw(1, 0, 700'000);  // above 0.4 ms, below twice that, and far below a's own
  EXPECT_TRUE(choice.decide(1));
  EXPECT_EQ(choice.now().scenario, kHalfGpu);
  choice.saw(1, 0, 1'300'000);
  EXPECT_TRUE(choice.decide(2)) << "its own of 1.2 ms at a third";
  EXPECT_EQ(choice.now().why, Why::kOutside);
  EXPECT_EQ(choice.now().allowed_ns, 1'200'000);
}

TEST_F(LossTest, WhatIsOffTellsNothing) {
  app_.xnodes.push_back({"c", "n", {{"gpu", 100}}});
  app_.xnodes.back().sources = {0};
  app_.modules.push_back({"n", 1, true});
  complete_chains(app_);
  tables_.app_hash = app_.hash();
  tables_.tables[0] = test::table_of(app_, "gpu", {1, 0, 1}, {2000, 3000, 2100});
  tables_.tables[1] = test::table_of(app_, "small", {1, 0, -1}, {3000, 4000, 1}, {{}, {"n"}});
  tables_.serves.clear();
  for (const int table : {0, 0, 1}) test::serve(tables_, app_, table);
  ASSERT_TRUE(validate(tables_, app_, platform_));
  ScenarioChoice choice = make();
  choice.saw(1, 2, kDwell);
  choice.hung(1, 2);
  EXPECT_FALSE(choice.decide(0));
  choice.saw(0, 2, kDwell);
  EXPECT_TRUE(choice.decide(1));
}

TEST_F(ChoiceTest, GoesBackAfterADwellWithoutNeedAndLaterWhereTheTrialFails) {
  ScenarioChoice choice = make();
  choice.saw(0, 0, 2 * kMilli);
  ASSERT_TRUE(choice.decide(0));
  std::vector<std::int64_t> backs;  // how long after the escalation
  std::int64_t since = 0;
  for (std::int64_t t = kMilli; backs.size() < 5; t += kMilli) {
    ASSERT_LT(t, 1000 * kDwell);
    // The GPU is slow for ever, but a job that shows it comes only under the nominal scenario.
    choice.saw(0, 0, choice.now().scenario == kNominal ? 2 * kMilli : kMilli / 2);
    if (!choice.decide(t)) continue;
    if (choice.now().scenario == kNominal) {
      EXPECT_EQ(choice.now().why, Why::kBack);
      backs.push_back(t - since);
    } else {
      since = t;
    }
  }
  for (std::size_t i = 0; i < backs.size(); ++i) EXPECT_GE(backs[i], kDwell << i) << i;
}

TEST_F(ChoiceTest, WhatIsAskedForIsAFloorAndIsGivenBackAtOnce) {
  ScenarioChoice choice = make();
  choice.ask(kNoGpu);
  EXPECT_TRUE(choice.decide(0));
  EXPECT_EQ(choice.now().scenario, kNoGpu);
  EXPECT_EQ(choice.now().table, 1);
  EXPECT_EQ(choice.now().why, Why::kAsked);
  choice.ask(-1);
  EXPECT_TRUE(choice.decide(1));
  EXPECT_EQ(choice.now().scenario, kNominal);
  EXPECT_EQ(choice.now().why, Why::kAsked);
}

TEST_F(ChoiceTest, TheMachineIsBelievedAtOnceUpwardsAndAfterADwellDownwards) {
  ScenarioChoice choice = make();
  choice.expect(kHalfCpu);
  EXPECT_TRUE(choice.decide(0));
  EXPECT_EQ(choice.now().scenario, kHalfCpu);
  EXPECT_EQ(choice.now().why, Why::kMachine);
  choice.expect(kNominal);
  EXPECT_FALSE(choice.decide(kDwell - 1));
  EXPECT_TRUE(choice.decide(kDwell));
  EXPECT_EQ(choice.now().scenario, kNominal);
}

TEST_F(ChoiceTest, OutsideOfEveryScenarioIsSaidAndEndsWhenItIsOver) {
  ScenarioChoice choice = make();
  choice.saw(0, 1, 3 * kMilli);  // b takes 2 ms where it is slowest
  choice.decide(0);
  EXPECT_EQ(choice.now().why, Why::kOutside);
  EXPECT_EQ(choice.now().xnode, 1);
  EXPECT_EQ(choice.now().saw_ns, 3 * kMilli);
  EXPECT_EQ(choice.now().allowed_ns, 2 * kMilli);
  EXPECT_EQ(choice.now().scenario, kHalfBoth)
      << "passed as little as by others, and it covers them";
  // What people ask for is kept meanwhile.
  choice.ask(kNoGpu);
  choice.decide(1);
  EXPECT_EQ(choice.now().scenario, kNoGpu);
  EXPECT_EQ(choice.now().why, Why::kOutside);
  choice.ask(-1);
  std::int64_t t = 2;
  for (; choice.now().scenario != kNominal && t < 10 * kDwell; t += kMilli) choice.decide(t);
  EXPECT_EQ(choice.now().scenario, kNominal);
  EXPECT_NE(choice.now().why, Why::kOutside);
}

TEST_F(ChoiceTest, OneJobThatIsFarTooLongDoesNotHideASlowXpu) {
  ScenarioChoice choice = make();
  choice.saw(0, 1, 50 * kMilli);  // b: the machine stood still
  choice.saw(0, 0, 2 * kMilli);   // a: the GPU is at half
  choice.decide(0);
  EXPECT_EQ(choice.now().scenario, kHalfBoth) << "a fits, and b passes it least";
  EXPECT_EQ(choice.now().why, Why::kOutside);
}

TEST_F(ChoiceTest, AnXpuFromWhichAJobDoesNotReturnIsLostUntilPeopleAskAnew) {
  ScenarioChoice choice = make();
  choice.saw(0, 0, 90 * kMilli);  // seen before its hang limit
  choice.decide(0);
  EXPECT_EQ(choice.now().why, Why::kOutside);
  choice.hung(0, 0);
  EXPECT_TRUE(choice.decide(1));
  EXPECT_EQ(choice.now().scenario, kNoGpu);
  EXPECT_EQ(choice.now().why, Why::kLost);
  EXPECT_EQ(choice.now().xnode, 0);
  EXPECT_EQ(choice.now().xpu, 1);
  choice.saw(0, 0, 95 * kMilli);  // it is still there
  for (std::int64_t t = 2; t < 200 * kDwell; t += 10 * kMilli)
    ASSERT_FALSE(choice.decide(t)) << "nothing has said that it is back";
  EXPECT_EQ(choice.now().why, Why::kLost);
  choice.ask(kHalfGpu);
  EXPECT_TRUE(choice.decide(201 * kDwell));
  EXPECT_EQ(choice.now().scenario, kHalfGpu);
  EXPECT_EQ(choice.now().why, Why::kAsked);
}

TEST_F(ChoiceTest, AnXpuThatIsLostIsSaidToBeEvenWhereItWasLeftAlready) {
  ScenarioChoice choice = make();
  choice.ask(kNoGpu);
  choice.saw(0, 1, 90 * kMilli);
  choice.decide(0);
  ASSERT_EQ(choice.now().scenario, kNoGpu);
  ASSERT_EQ(choice.now().why, Why::kOutside);
  choice.hung(0, 0);
  std::int64_t t = 1;
  for (; choice.now().why == Why::kOutside && t < 10 * kDwell; t += kMilli) choice.decide(t);
  EXPECT_EQ(choice.now().scenario, kNoGpu);
  EXPECT_EQ(choice.now().why, Why::kLost);
  EXPECT_EQ(choice.now().xpu, 1);
}

TEST_F(ChoiceTest, AnXpuThatNoScenarioDoesWithoutIsNotGivenUp) {
  ScenarioChoice choice = make();
  choice.hung(0, 1);  // b, on the CPU
  EXPECT_FALSE(choice.decide(0));
  EXPECT_EQ(choice.now().scenario, kNominal);
  choice.hung(0, 0);
  EXPECT_TRUE(choice.decide(1)) << "the GPU is another matter";
  EXPECT_EQ(choice.now().scenario, kNoGpu);
}

TEST_F(ChoiceTest, WhereNothingCoversBothTheMachineCounts) {
  ScenarioChoice choice = make();
  choice.ask(kNoGpu);
  choice.expect(kHalfCpu);
  choice.decide(0);
  EXPECT_EQ(choice.now().scenario, kHalfCpu);
  EXPECT_EQ(choice.now().why, Why::kOutside);
  EXPECT_EQ(choice.now().xnode, -1);
}

/// Whatever comes: after each decision no job of the last dwell is longer than the scenario allows, and
/// the floor is covered, unless no scenario does so. Nothing lower than that is left before a dwell.
TEST_F(ChoiceTest, RandomRunsKeepTheConditions) {
  std::mt19937_64 random(11);
  const auto draw = [&](std::int64_t low, std::int64_t high) {
    return std::uniform_int_distribution<std::int64_t>(low, high)(random);
  };
  const std::vector<std::int64_t> cpu = {100, 100, 200, 200, 100}, gpu = {100, 200, 100, 200, 100};
  const auto covered = [&](int s, int by) {
    return cpu[static_cast<std::size_t>(by)] >= cpu[static_cast<std::size_t>(s)] &&
           gpu[static_cast<std::size_t>(by)] >= gpu[static_cast<std::size_t>(s)] &&
           (s != kNoGpu || by == kNoGpu);
  };
  struct Seen {
    std::int64_t at, ns;
    int xnode, type;  // 0: CPU
  };
  const std::int64_t nominal_ns[2][2] = {{4 * kMilli, kMilli}, {kMilli, 0}};  // [xnode][type]
  const auto fits = [&](int s, const Seen& seen) {
    const auto pct =
        seen.type == 0 ? cpu[static_cast<std::size_t>(s)] : gpu[static_cast<std::size_t>(s)];
    return seen.ns * 100 <= nominal_ns[seen.xnode][seen.type] * pct;
  };
  std::uint64_t escalations = 0, backs = 0, outsides = 0, losses = 0;
  for (int round = 0; round < 300; ++round) {
    ScenarioChoice choice = make();
    std::vector<Seen> seen;
    int asked = -1, expected = -1;
    bool gpu_gone = false;
    std::int64_t now = 0;
    for (int step = 0; step < 200; ++step) {
      now += draw(1, 20) * kMilli;
      const int table = choice.now().table;
      for (int jobs = static_cast<int>(draw(0, 2)); jobs > 0; --jobs) {
        const int xnode = static_cast<int>(draw(0, 1));
        const int type = xnode == 0 && table == 0 ? 1 : 0;
        const std::int64_t ns =
            nominal_ns[xnode][type] * draw(50, draw(0, 30) == 0 ? 230 : 100) / 100;
        choice.saw(table, static_cast<std::size_t>(xnode), ns);
        if (type == 0 || !gpu_gone) seen.push_back({now, ns, xnode, type});
      }
      if (draw(0, 60) == 0) {
        // b is on the CPU, which no scenario does without.
        const int xnode = static_cast<int>(draw(0, 1));
        choice.hung(table, static_cast<std::size_t>(xnode));
        if (xnode == 0 && table == 0) {
          losses += gpu_gone ? 0 : 1;
          gpu_gone = true;
          std::erase_if(seen, [](const Seen& s) { return s.type == 1; });
        }
      }
      if (draw(0, 40) == 0) {
        const int wish = static_cast<int>(draw(-1, 4));
        gpu_gone = gpu_gone && wish == asked;
        choice.ask(asked = wish);
      }
      if (draw(0, 40) == 0) choice.expect(expected = static_cast<int>(draw(-1, 3)));
      const int before = choice.now().scenario;
      choice.decide(now);
      const Choice& chosen = choice.now();
      EXPECT_EQ(chosen.table, chosen.scenario == kNoGpu ? 1 : 0);
      std::erase_if(seen, [&](const Seen& s) { return now - s.at > 64 * 2 * kDwell; });
      // Of the last dwell; older ones may or may not count still.
      const auto recent = [&](const Seen& s) { return now - s.at < kDwell; };
      const auto good = [&](int s) {
        return (!gpu_gone || s == kNoGpu) && (asked < 0 || covered(asked, s)) &&
               (expected < 0 || covered(expected, s)) &&
               std::all_of(seen.begin(), seen.end(),
                           [&](const Seen& one) { return !recent(one) || fits(s, one); });
      };
      if (chosen.why == Why::kOutside) {
        ++outsides;
        // Nothing that anybody has seen so far would do.
        const auto ever = [&](int s) {
          return (!gpu_gone || s == kNoGpu) && (asked < 0 || covered(asked, s)) &&
                 (expected < 0 || covered(expected, s)) &&
                 std::all_of(seen.begin(), seen.end(),
                             [&](const Seen& one) { return fits(s, one); });
        };
        for (int s = 0; s < 5; ++s) ASSERT_FALSE(ever(s)) << round << " " << step << " " << s;
        continue;
      }
      ASSERT_TRUE(good(chosen.scenario)) << round << " " << step;
      escalations += chosen.scenario != before && chosen.why == Why::kOverrun ? 1 : 0;
      backs += chosen.scenario != before && chosen.why == Why::kBack ? 1 : 0;
    }
  }
  EXPECT_GT(escalations, 100u);
  EXPECT_GT(backs, 100u);
  EXPECT_GT(outsides, 100u);
  EXPECT_GT(losses, 100u);
}

}  // namespace
}  // namespace xauto::runtime

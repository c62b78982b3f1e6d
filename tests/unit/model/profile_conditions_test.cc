// SPDX-License-Identifier: Apache-2.0
// Profiles, each with the clocks and the mode that it was measured under, become scenarios with
// conditions, or a reason why not.
#include <gtest/gtest.h>

#include "model/contention.h"
#include "model/json.h"
#include "model/scenario.h"

namespace xauto {
namespace {

using Of = Reading::Of;
constexpr const char* kGpu = "/sys/class/devfreq/17000000.gpu/cur_freq";
constexpr const char* kEmc = "/sys/kernel/debug/bpmp/debug/clk/emc/rate";
constexpr const char* kPowerModeFile = "/var/lib/nvpmodel/status";

Reading clock(const char* file, std::int64_t min, std::int64_t max) {
  return {Of::kClock, file, {}, min, min, max, max};
}
Reading mode(std::vector<std::string> texts) {
  return {Of::kPowerMode, kPowerModeFile, {}, 0, 0, 0, 0, std::move(texts)};
}

NamedProfile profile(const std::string& name, std::int64_t us, std::vector<Reading> readings) {
  Profile p;
  p.app = "a";
  p.sources = {{"s", {1000}}};
  p.conditions.readings = std::move(readings);
  p.xnodes = {{"x", "M", {{"gpu0", {9, 1, 2, 3, us}}}, {0}}};
  return {name, p};
}

struct Made {
  std::string why;
  std::vector<Scenario> list;
};
Made make(const std::vector<NamedProfile>& profiles) {
  const Platform small = Platform::builtin("small").value();
  Scenarios scenarios = scenarios_of(profiles, small, WcetFrom::kMaxPlusMargin).value();
  const std::string why = set_conditions(scenarios, profiles);
  const AppSpec app = to_app(profiles[0].profile, small, WcetFrom::kMaxPlusMargin).value();
  const Status valid = validate(scenarios, app, small);
  EXPECT_TRUE(valid) << valid.error().to_string();
  return {why, scenarios.list};
}

TEST(ProfileConditions, ClocksThatDifferBecomeConditionsOnePercentBelow) {
  const auto [why, list] =
      make({profile("full", 100, {clock(kGpu, 1300500000, 1300500000), mode({"pmode:0000"})}),
            profile("half", 200, {clock(kGpu, 650000000, 655000000), mode({"pmode:0002"})})});
  EXPECT_EQ(why, "");
  ASSERT_EQ(list[0].when.size(), 1u) << "clocks say it: a mode of the same clocks is covered, too";
  EXPECT_EQ(list[0].when[0], (Condition{kGpu, 1287495000, {}, {}}));
  EXPECT_EQ(list[1].when[0], (Condition{kGpu, 643500000, {}, {}}));
}

TEST(ProfileConditions, AClockThatAllSharedIsOneOfThem) {
  const auto [why, list] =
      make({profile("full", 100, {clock(kGpu, 1000, 1000), clock(kEmc, 3000, 3000)}),
            profile("half", 200, {clock(kGpu, 500, 500), clock(kEmc, 3000, 3000)})});
  EXPECT_EQ(why, "");
  ASSERT_EQ(list[0].when.size(), 2u) << "with slower memory it was not measured";
  EXPECT_EQ(list[0].when[1], (Condition{kEmc, 2970, {}, {}}));
}

TEST(ProfileConditions, ModesTellApartWhatClocksDoNot) {
  const auto [why, list] = make({profile("maxn", 100, {clock(kGpu, 1000, 1000), mode({"0"})}),
                                 profile("30w", 200, {clock(kGpu, 1004, 1004), mode({"2"})})});
  EXPECT_EQ(why, "");
  ASSERT_EQ(list[1].when.size(), 2u);
  EXPECT_EQ(list[1].when[1], (Condition{kPowerModeFile, {}, {}, "2"}));
}

TEST(ProfileConditions, OneConditionWithTwoTimesIsSaidAndNobodyGetsAny) {
  const auto [why, list] = make({profile("quiet", 100, {clock(kGpu, 1000, 1000)}),
                                 profile("slow", 300, {clock(kGpu, 500, 500)}),
                                 profile("busy", 150, {clock(kGpu, 1000, 1000)})});
  EXPECT_EQ(why,
            "quiet and busy were measured under the same clocks and power mode, and their WCETs "
            "differ by 50 % (XNode 'x' on gpu)");
  for (const Scenario& scenario : list) EXPECT_TRUE(scenario.when.empty()) << scenario.name;
}

TEST(ProfileConditions, TheSameTimesUnderOneConditionDoNotMatter) {
  const auto [why, list] = make(
      {profile("a", 100, {clock(kGpu, 1000, 1000)}), profile("b", 100, {clock(kGpu, 1000, 1000)})});
  EXPECT_EQ(why, "");
  EXPECT_EQ(list[0].when, list[1].when);
}

TEST(ProfileConditions, AProfileUnderSeveralConditionsIsNoPoint) {
  for (const Reading& changed : {clock(kGpu, 300, 1000), mode({"0", "2"})}) {
    const auto [why, list] = make({profile("calm", 100, {clock(kGpu, 1000, 1000), mode({"0"})}),
                                   profile("not", 200, {changed})});
    EXPECT_NE(why.find("not was not measured under one condition: " + changed.file),
              std::string::npos)
        << why;
    EXPECT_TRUE(list[0].when.empty());
  }
  const Reading governor{Of::kGovernor, "/g", {}, 0, 0, 0, 0, {"powersave", "performance"}};
  EXPECT_EQ(make({profile("a", 10, {clock(kGpu, 1000, 1000), governor}),
                  profile("b", 20, {clock(kGpu, 500, 500)})})
                .why,
            "")
      << "what a governor does shows in its clock";
}

TEST(ProfileConditions, WhatOneOfThemLacksCannotBeCompared) {
  const auto [why, list] = make(
      {profile("a", 100, {clock(kGpu, 1000, 1000)}), profile("b", 200, {clock(kEmc, 500, 500)})});
  EXPECT_NE(why, "");
  EXPECT_TRUE(list[0].when.empty());
  EXPECT_EQ(make({profile("alone", 100, {clock(kGpu, 1000, 1000)})}).why, "");
}

TEST(ProfileConditions, EachCoRunClassIsStatedAndAScenarioHasTheWorst) {
  NamedProfile one = profile("x", 100, {});
  one.profile.xnodes[0].beside["cpu"]["gpu0"] = {9, 1, 2, 3, 130};
  one.profile.xnodes[0].beside["dla"]["gpu0"] = {9, 1, 2, 3, 110};
  const Platform small = Platform::builtin("small").value();
  const auto app = to_app(one.profile, small, WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(app);
  EXPECT_EQ(app->xnodes[0].wcet_on("gpu"), 120);
  EXPECT_EQ(wcet_beside(app->xnodes[0], "gpu", {{"cpu", 1}}), 156);
  EXPECT_EQ(wcet_beside(app->xnodes[0], "gpu", {{"dla", 1}}), 132);
  const auto merged = scenarios_of({one}, small, WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(merged);
  EXPECT_EQ(merged->list[0].wcet_us.at("x").at("gpu"), 156);
}

}  // namespace
}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// What is shown of the machine: numbers that were measured and no others, and who had an XPU at each instant.
#include "xauto/machine.h"

#include <algorithm>
#include <random>
#include <string>

#include <gtest/gtest.h>

namespace xauto::cli {
namespace {

Json machine(std::int64_t at_us, std::int64_t had_us, std::int64_t times, int lease = 1,
             const std::string& app = "drive") {
  return {{"at_us", at_us},
          {"coordinators", Json::array({Json{{"xpu", "core1"}, {"pid", 7}, {"slack_pct", 41}},
                                        Json{{"xpu", "gpu0"}, {"pid", 8}, {"slack_pct", Json()}}})},
          {"apps", Json::array({Json{{"lease", lease},
                                     {"app", app},
                                     {"uid", 1000},
                                     {"regulated", false},
                                     {"xpus", Json::array({Json{{"xpu", "core1"},
                                                                {"admitted_pct", 12.5},
                                                                {"had_us", had_us},
                                                                {"times", times}}})},
                                     {"pids", Json::array({77})}}})}};
}

std::optional<double> had(const Json& now, const Json& before) {
  return machine_xpus(now, before).at(0).apps.at(0).had_pct;
}

TEST(Machine, ANumberThatNobodyMeasuredIsNone) {
  EXPECT_DOUBLE_EQ(had(machine(2'000'000, 350'000, 9), machine(1'000'000, 100'000, 5)).value(), 25);
  EXPECT_EQ(had(machine(2'000'000, 350'000, 9), Json()), std::nullopt) << "one look";
  EXPECT_EQ(had(machine(2'000'000, 350'000, 9), machine(1'000'000, 100'000, 5, 2)), std::nullopt)
      << "another run";
  EXPECT_EQ(had(machine(2'000'000, 50'000, 9), machine(1'000'000, 100'000, 5)), std::nullopt)
      << "a worker has left";
  EXPECT_EQ(had(machine(2'000'000, 1'200'000, 6), machine(1'000'000, 100'000, 5)), std::nullopt)
      << "a job of more than a second ended in that second";
  EXPECT_EQ(had(machine(1'000'000, 1, 6), machine(1'000'000, 0, 5)), std::nullopt) << "no time";
  EXPECT_DOUBLE_EQ(had(machine(2'000'000, 0, 0), machine(1'000'000, 0, 0)).value(), 0);
}

TEST(Machine, IsShownAsATable) {
  const Json before = machine(1'000'000, 0, 0), now = machine(2'000'000, 101'000, 3);
  EXPECT_EQ(machine_text(now, before),
            "  together, % of its time      admitted       had     slack\n"
            "  core1                            12.5      10.1        41\n"
            "    drive (uid 1000)               12.5      10.1\n"
            "  gpu0                              0.0       0.0         -\n");
  EXPECT_EQ(machine_text(Json(), Json()), "");
  const Json json = machine_json(now, before);
  EXPECT_NEAR(json.at("apps").elements()[0].at("xpus").elements()[0].at("had_pct").number().value(),
              10.1, 1e-9);
  EXPECT_TRUE(machine_json(Json(), Json()).is_null());
}

/// Names are of other users: no terminal obeys them, and what is no answer of a service is no crash.
TEST(Machine, WhatOthersSayIsText) {
  EXPECT_EQ(machine_text(machine(2, 0, 0, 1, "\x1b[2J\n"), Json()).find('\x1b'), std::string::npos);
  for (const char* said :
       {"[]", "7", R"({"apps":7,"coordinators":"x"})", R"({"coordinators":[7,{}]})",
        R"({"coordinators":[{"xpu":"a"}],"apps":[{"xpus":[{"xpu":"a"},9]},null]})"}) {
    const Json told = Json::parse(said).value();
    (void)machine_text(told, told);
    (void)machine_json(told, told);
  }
}

TEST(Machine, WhoBeganLastHasTheXpu) {
  using coord::RecordedTime;
  // A has it from 0 to 10, and B from 3 to 5 in between; then C runs into D.
  const auto slices = one_at_a_time({{1, 1, 10}, {2, 3, 5}, {3, 20, 26}, {4, 24, 30}});
  ASSERT_EQ(slices.size(), 5U);
  EXPECT_EQ(slices[1].lease, 2U);
  EXPECT_EQ(slices[2].begin_ns, 5);
  EXPECT_EQ(slices[2].end_ns, 10);
  EXPECT_EQ(slices[3].end_ns, 24);
  EXPECT_EQ(slices[4].end_ns, 30);
  // Any times, by a second way: each instant is asked for.
  std::mt19937 dice(1);
  for (int round = 0; round < 2000; ++round) {
    std::vector<RecordedTime> times;
    std::vector<std::int64_t> begins(40);
    for (std::size_t i = 0; i < begins.size(); ++i) begins[i] = static_cast<std::int64_t>(i) + 1;
    std::shuffle(begins.begin(), begins.end(), dice);
    for (std::uint32_t lease = 1; lease <= 8; ++lease)
      times.push_back(
          {lease, begins[lease], begins[lease] + static_cast<std::int64_t>(dice() % 20)});
    const auto cut = one_at_a_time(times);
    for (std::int64_t t = 0; t < 70; ++t) {
      std::uint32_t who = 0, shown = 0;
      std::int64_t began = -1;
      for (const RecordedTime& time : times)
        if (time.begin_ns <= t && t < time.end_ns && time.begin_ns > began) {
          who = time.lease;
          began = time.begin_ns;
        }
      int slices_there = 0;
      for (const RecordedTime& time : cut)
        if (time.begin_ns <= t && t < time.end_ns) {
          shown = time.lease;
          ++slices_there;
        }
      ASSERT_EQ(shown, who) << "at " << t;
      ASSERT_LE(slices_there, 1);
    }
  }
}

}  // namespace
}  // namespace xauto::cli

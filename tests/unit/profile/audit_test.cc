// SPDX-License-Identifier: Apache-2.0
// When an audit says that an XNode uses another XPU: the coin against Pascal's triangle, the rule
// against loads that are drawn.
#include "profile/audit.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include <gtest/gtest.h>
#include <stdlib.h>

#include "base/clock.h"

namespace xauto::runtime {
namespace {

TEST(AuditRule, TheCoinIsPascalsTriangle) {
  std::vector<double> row = {1};
  for (std::size_t throws = 0; throws <= 40; ++throws) {
    double above = 0;
    for (std::size_t heads = throws + 1; heads-- > 0;) {
      above += row[heads];
      EXPECT_NEAR(chance_of_heads(heads, throws), above / std::pow(2.0, throws), 1e-9)
          << heads << " of " << throws;
    }
    std::vector<double> next(throws + 2, 1);
    for (std::size_t k = 1; k <= throws; ++k) next[k] = row[k - 1] + row[k];
    row = next;
  }
  EXPECT_EQ(chance_of_heads(0, 0), 1);
  EXPECT_GT(chance_of_heads(5000, 10000), 0.5);
  EXPECT_LT(chance_of_heads(9000, 10000), 1e-300);
}

TEST(AuditRule, SoManyRepetitionsCouldJustConvince) {
  for (const std::size_t questions : {1, 4, 100, 5000}) {
    const std::size_t needed = repetitions_needed(questions);
    const auto allowed = kFalseAlarm / static_cast<double>(questions);
    EXPECT_LE(std::pow(0.5, needed), allowed);
    EXPECT_GT(std::pow(0.5, needed - 1), allowed);
    const std::vector<BusyPair> always(needed, {500'000, 0});
    EXPECT_TRUE(judge(always, 1'000'000, questions).used);
    EXPECT_FALSE(judge({always.begin() + 1, always.end()}, 1'000'000, questions).used);
  }
}

TEST(AuditRule, WhatIsUsedEachTimeIsFoundUnderAnyLoad) {
  std::mt19937 random(3);
  std::uniform_int_distribution<std::int64_t> load(0, 1'000'000);
  std::vector<BusyPair> pairs;
  for (int i = 0; i < 200; ++i) pairs.push_back({load(random) + 400'000, load(random)});
  const OtherXpu found = judge(pairs, 5'000'000, 10);
  EXPECT_TRUE(found.used);
  EXPECT_NEAR(static_cast<double>(found.busy_us - found.idle_us), 400, 120);
}

TEST(AuditRule, LittleIsNothing) {
  EXPECT_FALSE(judge({}, 1'000'000, 1).used);
  EXPECT_FALSE(judge(std::vector<BusyPair>(50, {0, 0}), 1'000'000, 1).used);
  EXPECT_FALSE(judge(std::vector<BusyPair>(50, {9'000, 0}), 1'000'000, 1).used) << "0.9 %";
  EXPECT_TRUE(judge(std::vector<BusyPair>(50, {10'000, 0}), 1'000'000, 1).used);
  EXPECT_FALSE(judge(std::vector<BusyPair>(50, {0, 500'000}), 1'000'000, 1).used) << "less busy";
}

/// Bursts, drifts and heavy tails that know nothing of the XNode: as rarely wrong as the rule says.
TEST(AuditRule, LoadThatDoesNotKnowOfTheXNodeIsNotItsOwn) {
  std::mt19937 random(1);
  std::exponential_distribution<double> burst(1.0 / 300'000);
  std::bernoulli_distribution comes(0.2);
  constexpr int kAudits = 40'000;
  int alarms = 0;
  for (int a = 0; a < kAudits; ++a) {
    std::vector<BusyPair> pairs;
    for (int i = 0; i < 30; ++i) {
      const std::int64_t drift = i * 1000;
      const auto draw = [&] {
        return drift + (comes(random) ? static_cast<std::int64_t>(burst(random)) : 0);
      };
      pairs.push_back({draw(), draw()});
    }
    alarms += judge(pairs, 1'000'000, 1).used ? 1 : 0;
  }
  // kFalseAlarm of them, 4, on average; 20 has a chance below 1e-8 (Poisson).
  EXPECT_LE(alarms, 20);
}

TEST(AuditOfDrivers, ANumberThatLooksBackIsTakenAfterAQuietTime) {
  namespace fs = std::filesystem;
  std::string root = ::testing::TempDir() + "xauto-XXXXXX";
  ASSERT_NE(mkdtemp(root.data()), nullptr);
  const fs::path load = root + "/sys/class/devfreq/17000000.gpu/device/load";
  fs::create_directories(load.parent_path());
  fs::create_directories(root + "/proc");
  std::ofstream(load) << "40\n";
  std::ofstream(root + "/proc/stat") << "cpu 0 0 0 0 0 0 0\ncpu7 5 0 0 9 0 0 0\n";
  const Platform small = Platform::builtin("small").value();
  const int gpu = small.find("gpu0"), dla = small.find("dla0"), cpu = small.find("cpu0");
  Audit audit(small, {}, root, {7});
  EXPECT_EQ(audit.others(dla, false), (std::vector<int>{cpu, gpu}));
  EXPECT_TRUE(audit.others(dla, true).empty()) << "nothing is emulated here";
  const std::int64_t begun = now_ns();
  ASSERT_TRUE(audit.begin(dla, false));
  EXPECT_GE(now_ns() - begun, xpu::kLoadPeriodNs * xpu::kLoadPeriods);
  std::ofstream(load) << "60\n";
  std::ofstream(root + "/proc/stat") << "cpu7 6 0 2 9 0 0 0\n";
  const auto pairs = audit.end();
  ASSERT_TRUE(pairs) << pairs.error().to_string();
  // 17 samples of 16.7 ms: 283.9 ms, of which 4 and 6 %.
  EXPECT_EQ(pairs->at(gpu).idle_ns, 11'356'000);
  EXPECT_EQ(pairs->at(gpu).busy_ns, 17'034'000);
  EXPECT_EQ(pairs->at(cpu).busy_ns, 30'000'000) << "three ticks of 10 ms";
  EXPECT_EQ(pairs->at(cpu).idle_ns, 0);
  fs::remove_all(root);
}

}  // namespace
}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <atomic>
#include <random>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace xauto {
namespace {

constexpr std::int64_t kLong = 1'000'000'000;

TEST(JobsAbove, OneThatRunsCountsUntilNowAndNoLongerThanItMayTake) {
  JobsAbove jobs;
  const auto low = jobs.begin(0, 90, kLong), high = jobs.begin(1, 100, 50);
  EXPECT_EQ(jobs.above_ns(low, 130), 30);
  EXPECT_EQ(jobs.above_ns(low, 200), 50);
  EXPECT_EQ(jobs.above_ns(high, 200), 0) << "it is on that level itself";
  jobs.end(high, 170);  // longer than it may: that is told of itself
  EXPECT_EQ(jobs.above_ns(low, 200), 70);
}

/// Else the lowest would be told to be past its WCET because of time that the highest had.
TEST(JobsAbove, WhatOneThatRunsLendsToThoseAboveItIsNotItsOwn) {
  JobsAbove jobs;
  const auto low = jobs.begin(0, 90, kLong), middle = jobs.begin(1, 100, 50);
  jobs.end(jobs.begin(2, 110, 30), 130);
  EXPECT_EQ(jobs.above_ns(low, 165), 65) << "of its own the one in the middle has had 45";
  EXPECT_EQ(jobs.above_ns(low, 200), 70);
  (void)jobs.begin(2, 160, 30);
  EXPECT_EQ(jobs.above_ns(low, 195), 95) << "both run";
  EXPECT_EQ(jobs.above_ns(low, 300), 100);
  EXPECT_EQ(jobs.above_ns(middle, 300), 50);
  jobs.end(middle, 205);
  EXPECT_EQ(jobs.above_ns(low, 300), 105);
}

/// A process that died has ended nothing: what it may have had is kept when the level has another job.
TEST(JobsAbove, WhoDiesCountsForItsWcet) {
  JobsAbove jobs;
  const auto low = jobs.begin(0, 0, kLong);
  (void)jobs.begin(1, 10, 20);
  jobs.end(jobs.begin(1, 100, 20), 105);
  EXPECT_EQ(jobs.above_ns(low, 200), 25);
}

/// Against every instant on its own, over rows as the rule makes them: who starts is above all, anybody ends.
TEST(JobsAbove, HowManyThereWereDoesNotMatter) {
  std::mt19937 random(1);
  const auto roll = [&](int most) {
    return static_cast<int>(random() % static_cast<unsigned>(most));
  };
  for (int round = 0; round < 50; ++round) {
    JobsAbove jobs;
    struct Started {
      JobsAbove::Begun job;
      std::int64_t above = 0;  ///< instants in which another one was
    };
    std::vector<Started> row;
    int checked = 0;
    for (std::int64_t now = 1000; now < 4000; ++now) {
      for (int i = roll(3); i > 0; --i) {
        if (!row.empty() && roll(2) == 0) {
          // The lowest seldom, so that hundreds are above it.
          const auto at = row.begin() + (roll(50) == 0 ? 0 : roll(static_cast<int>(row.size())));
          if (at == row.begin() && row.size() > 1 && roll(20) > 0) continue;
          EXPECT_EQ(jobs.above_ns(at->job, now), at->above);
          jobs.end(at->job, now);
          row.erase(at);
          ++checked;
        } else if (row.empty() || row.back().job.level < 5) {
          row.push_back({jobs.begin(row.empty() ? 0 : row.back().job.level + 1, now, kLong)});
        }
      }
      for (const Started& one : row) EXPECT_EQ(jobs.above_ns(one.job, now), one.above);
      for (std::size_t i = 0; i + 1 < row.size(); ++i) ++row[i].above;
    }
    EXPECT_GT(checked, 200);
  }
}

/// Whoever looks sees a job that ends either as running or as ended, and never both or neither.
TEST(JobsAbove, ALookBesideAnEndCountsItOnce) {
  JobsAbove jobs;
  const auto low = jobs.begin(0, 0, kLong);
  std::atomic<std::int64_t> ended{0};
  std::thread above([&] {
    for (std::int64_t k = 0; k < 20'000; ++k) {
      jobs.end(jobs.begin(1, k, kLong), k + 1);
      ended = k + 1;
    }
  });
  while (ended < 20'000) {
    const std::int64_t least = ended;
    const std::int64_t seen = jobs.above_ns(low, least);
    EXPECT_GE(seen, least);
    EXPECT_LE(seen, ended + 1);
  }
  above.join();
}

}  // namespace
}  // namespace xauto

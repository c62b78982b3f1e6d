// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <algorithm>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(JobsAbove, OneThatRunsCountsUntilNowAndNoLongerThanItMayTake) {
  JobsAbove above;
  const auto job = above.begin(1, 100, 50);
  EXPECT_EQ(above.ns(0, 90, 130), 30);
  EXPECT_EQ(above.ns(0, 90, 200), 50);
  EXPECT_EQ(above.ns(1, 90, 200), 0) << "it is on that level itself";
  above.end(job, 170);  // longer than it may: that is told of itself
  EXPECT_EQ(above.ns(0, 90, 200), 70);
  EXPECT_EQ(above.ns(0, 120, 140), 20);
  EXPECT_EQ(above.ns(0, 170, 200), 0);
}

TEST(JobsAbove, WhoEndsLongAfterOthersChangesNothingOfTheirs) {
  JobsAbove above;
  const auto first = above.begin(1, 10, 5);
  for (std::size_t i = 0; i < JobsAbove::kKept; ++i) above.end(above.begin(1, 100, 0), 101);
  above.end(first, 1000);
  EXPECT_EQ(above.ns(0, 0, 2000), 1);
}

/// Else the lowest would be told to be past its WCET because of time that the highest had.
TEST(JobsAbove, WhatOneThatRunsLentToThoseAboveItIsNotItsOwn) {
  JobsAbove above;
  const auto middle = above.begin(1, 100, 50);
  above.end(above.begin(2, 110, 30), 130);
  EXPECT_EQ(above.ns(0, 90, 165), 65) << "of its own it has had 45";
  EXPECT_EQ(above.ns(0, 90, 200), 70);
  (void)above.begin(2, 160, 30);
  EXPECT_EQ(above.ns(0, 90, 195), 95) << "both run";
  EXPECT_EQ(above.ns(0, 90, 300), 100);
  EXPECT_EQ(above.ns(1, 90, 300), 50);
  above.end(middle, 205);
  EXPECT_EQ(above.ns(0, 90, 300), 105);
}

/// Against every instant on its own, some of them running: whoever looks began before them.
TEST(JobsAbove, OnesThatRunCountForWhatIsLeftOfThem) {
  std::mt19937 random(2);
  const auto roll = [&](int most) {
    return static_cast<std::int64_t>(random() % static_cast<unsigned>(most));
  };
  for (int round = 0; round < 2000; ++round) {
    JobsAbove above;
    std::vector<std::vector<bool>> had(5, std::vector<bool>(200));  // [level] at each instant
    struct Runs {
      std::int64_t begin, longest;
    };
    std::vector<std::optional<Runs>> run(5);  // [level] there is one job of a level at a time
    for (std::size_t level = 1; level < 5; ++level) {
      if (roll(2) == 0) {
        run[level] = Runs{roll(100), roll(40)};
        (void)above.begin(static_cast<int>(level), run[level]->begin, run[level]->longest);
        continue;
      }
      for (int i = 0; i < 3; ++i) {
        const std::int64_t begin = roll(100), end = begin + roll(20);
        above.end(above.begin(static_cast<int>(level), begin, 0), end);
        for (std::int64_t t = begin; t < end; ++t) had[level][static_cast<std::size_t>(t)] = true;
      }
    }
    for (std::size_t level = 4; level > 0; --level) {
      const auto higher = [&](std::size_t t) { return level < 4 && had[level + 1][t]; };
      auto all = had[level];
      std::int64_t left = run[level] ? run[level]->longest : 0;
      for (std::size_t t = 0; t < all.size() && left > 0; ++t)
        if (static_cast<std::int64_t>(t) >= run[level]->begin) {
          all[t] = true;
          left -= higher(t) ? 0 : 1;
        }
      for (std::size_t t = 0; t < all.size(); ++t) had[level][t] = all[t] || higher(t);
    }
    const std::int64_t until = roll(200);
    for (int level = 0; level < 4; ++level) {
      const auto& of = had[static_cast<std::size_t>(level) + 1];
      EXPECT_EQ(above.ns(level, 0, until), std::count(of.begin(), of.begin() + until, true));
    }
  }
}

/// Against every instant on its own.
TEST(JobsAbove, TimesThatOverlapCountOnce) {
  std::mt19937 random(1);
  const auto roll = [&](int most) {
    return static_cast<std::int64_t>(random() % static_cast<unsigned>(most));
  };
  for (int round = 0; round < 2000; ++round) {
    JobsAbove above;
    struct Job {
      int level;
      std::int64_t begin, end;
    };
    std::vector<Job> jobs;
    for (int i = 0; i < 12; ++i) {
      const std::int64_t begin = roll(100);
      jobs.push_back({static_cast<int>(1 + roll(3)), begin, begin + roll(30)});
      above.end(above.begin(jobs.back().level, begin, roll(50)), jobs.back().end);
    }
    const std::int64_t since = roll(60), until = since + roll(80);
    for (int level = 0; level < 4; ++level) {
      std::int64_t covered = 0;
      for (std::int64_t t = since; t < until; ++t)
        covered += std::any_of(jobs.begin(), jobs.end(), [&](const Job& job) {
          return job.level > level && job.begin <= t && t < job.end;
        });
      EXPECT_EQ(above.ns(level, since, until), covered);
    }
  }
}

}  // namespace
}  // namespace xauto

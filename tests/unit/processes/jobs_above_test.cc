// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <algorithm>
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

// SPDX-License-Identifier: Apache-2.0
#include "model/fifo_range.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(FifoRange, WithAllRightsIsTheDefault) {
  EXPECT_EQ(FifoRange::within(99), FifoRange{});
  EXPECT_EQ(FifoRange::within(60), FifoRange{});
}

TEST(FifoRange, WithoutAnyIsNothing) {
  EXPECT_TRUE(FifoRange::within(0).none());
  EXPECT_FALSE(FifoRange::within(1).none());
}

// Every limit: nothing is outside, and the order is kept.
TEST(FifoRange, UnderAnyLimitStaysInsideAndKeepsTheOrder) {
  for (int highest = 1; highest <= kFifoHighest; ++highest) {
    const FifoRange p = FifoRange::within(highest);
    for (const int level : {p.management, p.sources, p.execution, p.cpu_lowest, p.cpu_highest}) {
      EXPECT_GE(level, 1) << highest;
      EXPECT_LE(level, highest) << highest;
    }
    EXPECT_GE(p.management, p.sources) << highest;
    EXPECT_GE(p.sources, p.execution) << highest;
    EXPECT_GE(p.execution, p.cpu_highest) << highest;
    EXPECT_GE(p.cpu_highest, p.cpu_lowest) << highest;
    EXPECT_EQ(p.carriers, p.cpu_lowest > 1 ? 1 : 0) << highest;  // below every XNode, or none
    if (highest >= 2) {
      EXPECT_GT(p.management, p.cpu_highest) << highest;
    }
    if (highest >= 3) {
      EXPECT_GT(p.sources, p.execution) << highest;
      EXPECT_GT(p.execution, p.cpu_highest) << highest;
    }
    if (highest >= 4) {
      EXPECT_GT(highest, p.management) << highest;  // coordinators
    }
    if (highest >= 5) {
      EXPECT_GT(p.management, p.sources) << highest;
    }
    // What is left is the XNodes'.
    if (highest >= 7) {
      EXPECT_EQ(p.cpu_highest, std::min(39, highest - 4));
      EXPECT_EQ(p.cpu_lowest, 2);
    }
  }
}

PriorityPlan policy_of(std::vector<std::int64_t> priorities) {
  PriorityPlan policy;
  for (const std::int64_t priority : priorities) {
    PriorityPlacement placement;
    placement.xpu = 0;
    placement.priority = priority;
    policy.placements.push_back(placement);
  }
  return policy;
}

TEST(FifoRange, RanksGoDownFromTheHighestAndShareTheLowest) {
  const PriorityPlan policy = policy_of({-5, 1000, 7, 900, 8});
  const auto ranks = [&](int highest) { return FifoRange::within(highest).by_rank(policy); };
  EXPECT_EQ(ranks(60), (std::vector<int>{35, 39, 36, 38, 37}));
  EXPECT_EQ(ranks(8), (std::vector<int>{2, 4, 2, 3, 2}));  // 4 levels above: 8, 7, 6, 5
  EXPECT_EQ(ranks(1), (std::vector<int>{1, 1, 1, 1, 1}));
}

TEST(FifoRange, RanksAreThoseOfTheirOwnXpu) {
  PriorityPlan policy = policy_of({1, 2, 3});
  policy.placements[2].xpu = 1;
  EXPECT_EQ(FifoRange{}.by_rank(policy), (std::vector<int>{38, 39, 39}));
}

TEST(FifoRange, SmallerRangeIsSaid) {
  const PriorityPlan policy = policy_of({1, 2, 3, 4, 5});
  EXPECT_EQ(FifoRange{}.note(60, policy, {0}), "");
  EXPECT_EQ(FifoRange::within(0).note(0, policy, {0}), "") << "that is said elsewhere";
  EXPECT_EQ(FifoRange::within(20).note(20, policy, {0}),
            "SCHED_FIFO is permitted up to 20, not 60: XNodes on CPUs use 2 to 16");
  EXPECT_EQ(FifoRange::within(8).note(8, policy, {0}),
            "SCHED_FIFO is permitted up to 8, not 60: XNodes on CPUs use 2 to 4; the 3 least "
            "urgent of them share the lowest");
  EXPECT_EQ(FifoRange::within(8).note(8, policy, {1}),
            "SCHED_FIFO is permitted up to 8, not 60: XNodes on CPUs use 2 to 4");
}

}  // namespace
}  // namespace xauto

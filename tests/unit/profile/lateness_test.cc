// SPDX-License-Identifier: Apache-2.0
// What a profile says of the jitter of its sources, of a machine that stands still at times.
#include "profile/lateness.h"

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;

TEST(Lateness, JitterIsTwiceTheLatestWakeUp) {
  Lateness late(33'000);
  EXPECT_EQ(late.jitter_us(), 1);
  for (const std::int64_t ns : {50'000L, 16 * kMs, 70'000L}) late.add(ns);
  EXPECT_EQ(late.jitter_us(), 32'001);
  EXPECT_EQ(late.wake_ups(), 3);
  EXPECT_EQ(late.stalls(), 0);
}

/// As jitter it would be above the period, and no chain would be done within one.
TEST(Lateness, HalfAPeriodIsAStall) {
  Lateness late(33'000);
  for (const std::int64_t ns : {16'500'000L, 116 * kMs, 50'000L, 16'500'001L}) late.add(ns);
  EXPECT_EQ(late.jitter_us(), 33'001);
  EXPECT_EQ(late.stalls(), 2);
  EXPECT_EQ(late.wake_ups(), 4);
  EXPECT_EQ(late.longest_stall_ns(), 116 * kMs);
}

}  // namespace
}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
#include "runtime/urgency.h"

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

TEST(Urgency, AKeyMovesWithTheReleaseAPriorityDoesNot) {
  const Urgency priority = Urgency::of_priority(5);
  EXPECT_EQ(priority.key(1'000'000, 3), coord::key_of_priority(5));
  EXPECT_FALSE(priority.holds());
  const Urgency key = Urgency::of_keys({1000, 2000}, {500});
  EXPECT_EQ(key.key(10'000'000, 0), 11'000'000);
  EXPECT_EQ(key.key(10'000'000, 7), 12'000'000) << "entry n mod 2";
  EXPECT_TRUE(key.holds());
  EXPECT_EQ(key.hold(10'000'000, 7), 10'500'000);
}

TEST(Urgency, KeyAndHoldOfAnUrgentReleaseAreEarlier) {
  const Urgency key = Urgency::of_keys({1000, 2000}, {500, 100}, 300);
  EXPECT_EQ(key.key(10'000'000, 1, true), 11'700'000);
  EXPECT_EQ(key.key(10'000'000, 1, false), 12'000'000);
  EXPECT_EQ(key.hold(10'000'000, 0, true), 10'200'000);
  EXPECT_EQ(key.hold(10'000'000, 1, true), 10'000'000) << "not before its release";
  EXPECT_EQ(Urgency::of_priority(5).key(0, 0, true), coord::key_of_priority(5));
}

TEST(Urgency, PlannedStartsStandInThePlaceOfHolds) {
  Urgency key = Urgency::of_keys({1000}, {}, 300);
  key.plan_starts({500, 700}, {});
  EXPECT_TRUE(key.holds());
  EXPECT_EQ(key.hold(10'000'000, 1), 10'700'000);
  EXPECT_EQ(key.hold(10'000'000, 1, true), 10'000'000) << "an urgent release has none";
  key.plan_starts({500, 700}, {250});
  EXPECT_EQ(key.hold(10'000'000, 1, true), 10'250'000);
}

}  // namespace
}  // namespace xauto::runtime

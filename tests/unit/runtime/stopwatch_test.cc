// SPDX-License-Identifier: Apache-2.0
// What a job took, by a clock that the test holds.
#include "runtime/stopwatch.h"

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

TEST(Stopwatch, TimesAJobWithoutTheTimeForWhichItWasSuspended) {
  Stopwatch watch;
  EXPECT_FALSE(watch.look(5));
  watch.begin(100, 7);
  EXPECT_EQ(watch.look(150)->took_ns, 50);
  EXPECT_EQ(watch.look(150)->sequence, 7u);
  watch.away(160);
  EXPECT_EQ(watch.look(500)->took_ns, 60);  // it stands still
  watch.back(560);
  EXPECT_EQ(watch.look(570)->took_ns, 70);
  watch.away(580);
  watch.back(590);
  EXPECT_EQ(watch.end(600), 90);
  EXPECT_FALSE(watch.look(700));
}

TEST(Stopwatch, AJobThatEndsWhileItIsBeingSuspendedIsNotChargedForIt) {
  Stopwatch watch;
  watch.begin(100, 0);
  watch.away(150);
  EXPECT_EQ(watch.end(180), 50);  // FINISH overtook SUSPEND
  watch.back(200);
  watch.begin(210, 1);
  EXPECT_EQ(watch.end(230), 20);
}

TEST(Stopwatch, TellsOneJobFromTheNext) {
  Stopwatch watch;
  watch.begin(0, 3);
  const std::uint64_t first = watch.look(1)->job;
  watch.end(2);
  watch.begin(2, 3);
  EXPECT_NE(watch.look(3)->job, first);
}

}  // namespace
}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// What a job took, by a clock that the test holds.
#include "runtime/watch.h"

#include <gtest/gtest.h>

#include "../no_more_threads.h"

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

TEST(Limits, ComeFromTheWcetOrAreSaid) {
  Deployment d;
  d.defaults.budget_pct = 150;
  d.defaults.hang_pct = 1000;
  d.modules["B"].hang_us = 77;
  d.modules["B"].on_hang = OnHang::kDrop;
  d.budgets_us["a2"] = 5;
  const Limits a1 = Limits::of(d, "A", "a1", 200);
  EXPECT_EQ(a1.budget_ns, 300'000);
  EXPECT_EQ(a1.hang_ns, 2'000'000);
  EXPECT_EQ(a1.on_hang, OnHang::kLog);
  EXPECT_EQ(Limits::of(d, "A", "a2", 200).budget_ns, 5'000);
  EXPECT_EQ(Limits::of(d, "B", "b1", 200).hang_ns, 77'000);
  EXPECT_EQ(Limits::of(d, "B", "b1", 200).on_hang, OnHang::kDrop);
  EXPECT_FALSE(Limits::of({}, "A", "a1", 200).any());
  EXPECT_GT(Limits::of(d, "A", "a1", 1'000'000'000'000).hang_ns, 0);  // no overflow
}

TEST(Watchdog, LooksUntilItIsStopped) {
  std::atomic<int> looks{0};
  const auto dog = Watchdog::start(1'000, [&](std::int64_t) { ++looks; });
  ASSERT_TRUE(dog);
  while (looks.load() < 3) std::this_thread::yield();
  (*dog)->stop();
  const int seen = looks.load();
  std::this_thread::yield();
  EXPECT_EQ(looks.load(), seen);
}

TEST(Watchdog, WhereThreadsEndItSaysSo) {
  const NoMoreThreads none;
  const auto dog = Watchdog::start(1'000, [](std::int64_t) {});
  ASSERT_FALSE(dog);
  EXPECT_EQ(dog.error().what.find("no more threads: "), 0u) << dog.error().what;
}

}  // namespace
}  // namespace xauto::runtime

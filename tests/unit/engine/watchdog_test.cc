// SPDX-License-Identifier: Apache-2.0
#include "engine/watchdog.h"

#include <atomic>
#include <thread>

#include <gtest/gtest.h>

#include "base/clock.h"

#include "../no_more_threads.h"

namespace xauto::runtime {
namespace {

TEST(Watchdog, LooksUntilItIsStopped) {
  std::atomic<int> looks{0};
  const auto dog =
      Watchdog::start(*Alarm::make(), 1'000, [&](std::int64_t, std::int64_t) { ++looks; });
  ASSERT_TRUE(dog);
  while (looks.load() < 3) std::this_thread::yield();
  (*dog)->stop();
  const int seen = looks.load();
  std::this_thread::yield();
  EXPECT_EQ(looks.load(), seen);
}

TEST(Watchdog, LooksWhenItIsAskedToAndStopsWithoutWaiting) {
  constexpr std::int64_t kNeverNs = 3'600'000'000'000;
  const std::shared_ptr<Alarm> alarm = *Alarm::make();
  std::atomic<std::int64_t> looked_ns{0}, late{0};
  const auto dog = Watchdog::start(alarm, kNeverNs, [&](std::int64_t now, std::int64_t late_ns) {
    late = late_ns;
    looked_ns = now;
  });
  ASSERT_TRUE(dog);
  for (int n = 0; n < 3; ++n) {
    const std::int64_t due_ns = now_ns() + 2'000'000;
    alarm->by(due_ns);
    alarm->by(due_ns + kNeverNs);  // not later for that
    // What it was asked before it began it has not heard.
    while (looked_ns.load() < due_ns) alarm->by(due_ns);
    EXPECT_GE(late.load(), 0);
  }
  (*dog)->stop();
}

TEST(Watchdog, WhereThreadsEndItSaysSo) {
  const NoMoreThreads none;
  const auto dog = Watchdog::start(*Alarm::make(), 1'000, [](std::int64_t, std::int64_t) {});
  ASSERT_FALSE(dog);
  EXPECT_EQ(dog.error().what.find("no more threads: "), 0u) << dog.error().what;
}

}  // namespace
}  // namespace xauto::runtime

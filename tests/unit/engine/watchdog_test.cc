// SPDX-License-Identifier: Apache-2.0
#include "engine/watchdog.h"

#include <atomic>
#include <thread>

#include <gtest/gtest.h>

#include "../no_more_threads.h"

namespace xauto::runtime {
namespace {

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

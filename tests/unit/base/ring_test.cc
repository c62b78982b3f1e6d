// SPDX-License-Identifier: Apache-2.0
#include "base/ring.h"

#include <deque>
#include <memory>
#include <random>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Ring, IsAQueueWhateverComesAndGoes) {
  Ring<int> ring;
  std::deque<int> queue;
  std::mt19937 random(1);
  for (int i = 0; i < 20'000; ++i) {
    if (random() % 64 == 0) {
      ring.clear();
      queue.clear();
    } else if (queue.empty() || random() % 9 < 5) {
      ring.push_back(i);
      queue.push_back(i);
    } else {
      ASSERT_EQ(ring.front(), queue.front());
      ring.pop_front();
      queue.pop_front();
    }
    ASSERT_EQ(ring.size(), queue.size());
    ASSERT_EQ(ring.empty(), queue.empty());
  }
  for (; !queue.empty(); queue.pop_front(), ring.pop_front())
    ASSERT_EQ(ring.front(), queue.front());
  EXPECT_TRUE(ring.empty());
}

TEST(Ring, LetsGoOfWhatWasTakenOut) {
  Ring<std::shared_ptr<int>> ring;
  const auto held = std::make_shared<int>(1);
  for (int i = 0; i < 5; ++i) ring.push_back(held);
  ring.pop_front();
  EXPECT_EQ(held.use_count(), 5);
  ring.clear();
  EXPECT_EQ(held.use_count(), 1);
}

TEST(Ring, IsEmptyOnceItsItemsWereMovedAway) {
  Ring<int> ring;
  ring.push_back(1);
  ring.push_back(2);
  Ring<int> other = std::exchange(ring, {});
  EXPECT_TRUE(ring.empty());
  ring.push_back(3);
  EXPECT_EQ(ring.front(), 3);
  EXPECT_EQ(other.size(), 2u);
}

}  // namespace
}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// docs/keys.md, "Enforcement": the key of a job is b + w, b = max(t, b' + p), and it does not start before b + w - l.
#include "coord/regulator.h"

#include <gtest/gtest.h>

namespace xauto::coord {
namespace {

TEST(Regulator, WhoAsksOnceAPeriodHasItsWindowFromThenOn) {
  Regulator regulator({.period_ns = 100, .window_ns = 40, .longest_ns = 60, .budget_ns = 10});
  for (const std::int64_t t : {1000, 1100, 1250, 1350}) {
    const auto window = regulator.ask(t);
    ASSERT_TRUE(window);
    EXPECT_EQ(window->key, t + 40);
    EXPECT_EQ(window->not_before_ns, t - 20);
  }
}

TEST(Regulator, WhoAsksSoonerWaitsForHisTurn) {
  Regulator regulator({.period_ns = 100, .window_ns = 40, .longest_ns = 60, .budget_ns = 10});
  (void)regulator.ask(1000);
  for (int n = 1; n < 5; ++n) {
    const auto window = regulator.ask(1000 + n);
    ASSERT_TRUE(window);
    EXPECT_EQ(window->key, 1000 + 100 * n + 40);
    EXPECT_EQ(window->not_before_ns, 1000 + 100 * n - 20);
  }
}

TEST(Regulator, WhoseTurnIsHoursAwayIsNotHeard) {
  Regulator regulator(
      {.period_ns = kMaxRegulatedNs, .window_ns = 40, .longest_ns = 60, .budget_ns = 10});
  EXPECT_TRUE(regulator.ask(0));
  EXPECT_TRUE(regulator.ask(0));
  EXPECT_FALSE(regulator.ask(0));
  EXPECT_TRUE(regulator.ask(kMaxRegulatedNs));
}

TEST(Regulator, WhatCannotBeIsSeen) {
  const SporadicTask good{.period_ns = 100, .window_ns = 40, .longest_ns = 60, .budget_ns = 10};
  EXPECT_TRUE(good.makes_sense());
  for (std::int64_t SporadicTask::*const field :
       {&SporadicTask::period_ns, &SporadicTask::window_ns, &SporadicTask::longest_ns,
        &SporadicTask::budget_ns})
    for (const std::int64_t bad : {INT64_MIN, std::int64_t{-1}, std::int64_t{0}, INT64_MAX}) {
      SporadicTask task = good;
      task.*field = bad;
      EXPECT_FALSE(task.makes_sense());
    }
  SporadicTask task = good;
  task.budget_ns = 41;
  EXPECT_FALSE(task.makes_sense());
  task = good;
  task.window_ns = 61;
  EXPECT_FALSE(task.makes_sense());
}

}  // namespace
}  // namespace xauto::coord

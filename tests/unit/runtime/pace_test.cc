// SPDX-License-Identifier: Apache-2.0
// What is fed from outside: a sensor as app.json states it is never held up; a flood is let through
// at the stated period.
#include <cstdint>
#include <random>

#include <gtest/gtest.h>

#include "runtime/feeds.h"

namespace xauto::runtime {
namespace {

TEST(Pace, ASensorAsStatedIsNeverHeldUp) {
  std::mt19937_64 dice(1);
  for (int round = 0; round < 200; ++round) {
    const auto period = static_cast<std::int64_t>(1'000 + dice() % 1'000'000);
    const auto jitter = static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(2 * period));
    const auto ppm = static_cast<std::int64_t>(dice() % 1000);
    const std::int64_t slack = period * ppm / 1'000'000;
    Pace pace(period, jitter, ppm);
    auto nominal = static_cast<std::int64_t>(dice() % 1'000'000'000);
    for (std::int64_t last = 0, k = 0; k < 300; ++k) {
      // Messages of one sensor do not overtake each other, however late they are.
      const auto late = static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(jitter + 1));
      const std::int64_t at = std::max(last, nominal + late);
      ASSERT_LE(pace.earliest_ns(), at) << round << " " << k;
      pace.passed(at);
      last = at;
      const auto drift =
          static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(2 * slack + 1));
      nominal += period - slack + drift;
      if (dice() % 20 == 0) nominal += static_cast<std::int64_t>(dice() % 5) * period;  // left out
    }
  }
}

TEST(Pace, AFloodComesThroughAtTheStatedPeriod) {
  constexpr std::int64_t kPeriod = 10'000, kJitter = 7'000;
  Pace pace(kPeriod, kJitter, 0);
  std::int64_t passed = 0;
  for (std::int64_t at = 5; at < 1'000'000; at += 3) {
    if (at < pace.earliest_ns()) continue;
    pace.passed(at);
    ++passed;
    EXPECT_LE(passed, (at - 5 + kJitter) / kPeriod + 1);
  }
  EXPECT_GE(passed, 99);
}

}  // namespace
}  // namespace xauto::runtime

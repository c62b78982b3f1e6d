// SPDX-License-Identifier: Apache-2.0
// What is fed from outside: a sensor as app.json states it is never held up; a flood is let through
// at the stated period. An app of one rate follows its feeder and loses nothing of it.
#include <algorithm>
#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "releases/feeds.h"

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

/// An app of one rate that is fed, in virtual time: what is lost of what comes, of which the newest waits.
struct Fed {
  std::int64_t replaced = 0;
  std::int64_t waited_ns = 0;    ///< the longest of the last hundred messages
  std::int64_t per_release = 0;  ///< from one to the next, in the mean
};
/// `arrivals` in order. Each release is woken up to `wake_ns` late and decodes for `decode_ns`.
Fed feed(const std::vector<std::int64_t>& arrivals, std::int64_t period_ns, std::int64_t wake_ns,
         std::int64_t decode_ns) {
  std::mt19937_64 dice(7);
  Fed fed;
  FedGrid grid;
  std::int64_t due = 0, free = 0, taken = 0, first = 0, last = 0;
  for (std::size_t next = 0; next < arrivals.size(); ++taken) {
    const std::int64_t look =
        std::max(due, free) +
        static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(wake_ns));
    std::optional<std::int64_t> came;
    std::int64_t at = look;
    if (arrivals[next] > look)
      came = at =
          arrivals[next] + static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(wake_ns));
    while (next + 1 < arrivals.size() && arrivals[next + 1] <= at) {
      ++next;
      ++fed.replaced;
    }
    if (arrivals.size() - next <= 100) fed.waited_ns = std::max(fed.waited_ns, at - arrivals[next]);
    ++next;
    free = at + decode_ns;
    due += grid.move_ns(due, period_ns, came) + period_ns;
    if (taken == 0) first = at;
    last = at;
  }
  fed.per_release = (last - first) / std::max<std::int64_t>(taken - 1, 1);
  return fed;
}
/// A message per period, up to `jitter_ns` late; the feeder's clock is `ppm` faster than ours.
std::vector<std::int64_t> come(std::size_t count, std::int64_t period_ns, std::int64_t jitter_ns,
                               std::int64_t ppm) {
  std::mt19937_64 dice(3);
  std::vector<std::int64_t> arrivals;
  for (std::size_t k = 0; k < count; ++k)
    arrivals.push_back(
        1'000'000'000 + static_cast<std::int64_t>(k) * (period_ns - period_ns * ppm / 1'000'000) +
        static_cast<std::int64_t>(dice() % static_cast<std::uint64_t>(jitter_ns + 1)));
  return arrivals;
}

constexpr std::int64_t kPeriodNs = 10'000'000;

TEST(FedGrid, WakingAndDecodingDoNotAddUpUntilAMessageIsLost) {
  for (const std::int64_t ppm : {0, -100, 100, 500}) {
    const Fed fed = feed(come(20'000, kPeriodNs, 2'000'000, ppm), kPeriodNs, 300'000, 1'000'000);
    EXPECT_EQ(fed.replaced, 0) << ppm;
    // The messages' own jitter and a wake-up, and not a period.
    EXPECT_LT(fed.waited_ns, 3'000'000) << ppm;
  }
}

TEST(FedGrid, AMessageThatIsLateOnceDoesNotHoldUpAllToCome) {
  std::vector<std::int64_t> arrivals = come(130, kPeriodNs, 0, 0);
  arrivals[10] += 8'000'000;  // the last hundred begin twenty later
  const Fed fed = feed(arrivals, kPeriodNs, 10'000, 100'000);
  EXPECT_EQ(fed.replaced, 0);
  EXPECT_LT(fed.waited_ns, 100'000);
}

TEST(FedGrid, WhatBeginsWithABurstIsNotAPeriodBehindForEver) {
  std::vector<std::int64_t> arrivals = come(130, kPeriodNs, 0, 0);
  arrivals[0] = arrivals[1];
  const Fed fed = feed(arrivals, kPeriodNs, 10'000, 100'000);
  EXPECT_LT(fed.waited_ns, 100'000);
}

TEST(FedGrid, WhoWasSlowCannotBeFastAfterwards) {
  std::vector<std::int64_t> arrivals = come(1000, kPeriodNs, 0, -500'000);  // half as fast
  const std::size_t slow = arrivals.size();
  const std::vector<std::int64_t> flood = come(10'000, kPeriodNs / 10, 0, 0);
  for (const std::int64_t at : flood) arrivals.push_back(arrivals[slow - 1] + at - flood.front());
  const Fed fed = feed(arrivals, kPeriodNs, 10'000, 100'000);
  // A thousand periods of a flood are a thousand releases, one for the period that it may be behind, and one by the
  // thousandths.
  EXPECT_GE(fed.replaced, 10'000 - 1000 - 3);
}

TEST(FedGrid, AFloodIsTakenAtThePeriodOrAThousandthFaster) {
  const Fed fed = feed(come(100'000, kPeriodNs / 10, 0, 0), kPeriodNs, 10'000, 100'000);
  EXPECT_GE(fed.per_release,
            kPeriodNs - kPeriodNs / 1000 - kPeriodNs / 5000);  // once a period at the beginning
  EXPECT_LE(fed.per_release, kPeriodNs + 20'000);
  EXPECT_GT(fed.replaced, 89'000);
}

}  // namespace
}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Instants chosen for sensors that release by themselves are judged by the two conditions that a
// certificate asks for, computed here; the sensors are made here, too.
#include "grid/phase.h"

#include <cstdlib>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kOwnNs = 2000;  ///< what the tracker itself may add to a distance

struct Sensor {
  Grid::Source source;
  double speed = 1;           ///< of its clock: below 1 its periods are short
  std::int64_t start_ns = 0;  ///< its release 0, by our clock
  std::int64_t most_late_ns = 0;
  [[nodiscard]] std::int64_t due(std::uint64_t k) const {
    return start_ns + static_cast<std::int64_t>(static_cast<double>(source.due_ns(k)) * speed);
  }
};

Sensor camera(std::int64_t jitter_ns) {
  Sensor sensor;
  sensor.source = {{100'000, 3}, 0, jitter_ns, 0};
  sensor.start_ns = 5'000'000 * kMs;
  sensor.most_late_ns = jitter_ns;
  return sensor;
}

TEST(Phase, WhateverASensorDoesThatIsAsStatedHasAGrid) {
  std::mt19937_64 random(7);
  for (int round = 0; round < 200; ++round) {
    SCOPED_TRACE(round);
    const std::int64_t ppm = std::uniform_int_distribution<std::int64_t>(0, 200)(random);
    Sensor sensor = camera(2 * kMs);
    // Half of what it states: then the first message may have been anywhere in it.
    sensor.most_late_ns = kMs;
    sensor.speed = 1 + std::uniform_real_distribution<double>(-0.9, 0.9)(random) * 1e-6 *
                           static_cast<double>(ppm);
    ClockPhase phase(ppm);
    EXPECT_FALSE(phase.base_ns());
    std::int64_t before = 0;
    ClockPhase::Stream stream;
    std::uint64_t last = 0;
    for (std::uint64_t k = 0; k < 500; ++k) {
      if (k > 0 && random() % 50 == 0) continue;  // a frame is left out
      const std::int64_t at = sensor.due(k) + std::uniform_int_distribution<std::int64_t>(
                                                  0, sensor.most_late_ns)(random);
      const auto seen = phase.arrived(at, sensor.source, stream);
      ASSERT_TRUE(seen);
      ASSERT_EQ(seen->number, k);
      EXPECT_EQ(seen->off_ns, 0) << k;
      EXPECT_LE(seen->nominal_ns, at);
      EXPECT_LE(at, seen->nominal_ns + sensor.source.jitter_ns);
      if (k > 0) {
        const auto apart = static_cast<std::int64_t>(k - last) * sensor.source.period_ns();
        const std::int64_t allowed = kOwnNs + ppm * (apart + 2 * kMs) / 1'000'000;
        EXPECT_LE(std::abs(seen->nominal_ns - before - apart), allowed) << k;
      }
      before = seen->nominal_ns;
      last = k;
    }
  }
}

/// Sends `count` messages of the sensor, and returns how many were off.
template <class Late>
int off(ClockPhase& phase, const Sensor& sensor, std::uint64_t count, Late late) {
  int found = 0;
  ClockPhase::Stream stream;
  for (std::uint64_t k = 0; k < count; ++k) {
    const auto seen = phase.arrived(sensor.due(k) + late(k), sensor.source, stream);
    EXPECT_TRUE(seen && seen->number == k) << k;
    found += seen->off_ns > 0 ? 1 : 0;
  }
  return found;
}

TEST(Phase, WhatIsNotAsStatedIsTold) {
  const auto in_time = [](std::uint64_t) { return 0; };
  Sensor sensor = camera(kMs);
  {
    ClockPhase phase(100);
    sensor.speed = 1.0002;  // the clock is 200 ppm slow
    EXPECT_GT(off(phase, sensor, 2000, in_time), 0);
  }
  {
    ClockPhase phase(300);
    EXPECT_EQ(off(phase, sensor, 2000, in_time), 0);
  }
  {
    ClockPhase phase(100);
    sensor.speed = 0.99;  // another period: all but the first few are off
    EXPECT_GT(off(phase, sensor, 100, in_time), 90);
  }
  sensor.speed = 1;
  {
    ClockPhase phase(100);
    EXPECT_EQ(off(phase, sensor, 100, [](std::uint64_t k) { return k == 50 ? 3 * kMs : 0; }), 1);
  }
  {
    ClockPhase phase(100);  // it is moved by 5 ms for good: a grid of its own after a few
    const int found = off(phase, sensor, 100, [](std::uint64_t k) { return k < 50 ? 0 : 5 * kMs; });
    EXPECT_GT(found, 0);
    EXPECT_LT(found, 10);
  }
  {
    ClockPhase phase(100);  // earlier for good: the first one tells
    EXPECT_EQ(off(phase, sensor, 100, [](std::uint64_t k) { return k < 50 ? 0 : -5 * kMs; }), 1);
  }
}

TEST(Phase, SourcesOfOneClockShareAGrid) {
  Sensor front = camera(kMs), rear = camera(kMs);
  rear.source.offset_ns = 10 * kMs;
  ClockPhase phase(0);
  ClockPhase::Stream of_front, of_rear;
  const auto first = phase.arrived(front.due(0), front.source, of_front);
  EXPECT_EQ(first->nominal_ns, front.due(0) - kMs / 2);
  EXPECT_EQ(*phase.base_ns(), first->nominal_ns);
  const auto second = phase.arrived(rear.due(0) + kMs / 4, rear.source, of_rear);
  EXPECT_EQ(second->number, 0u);
  EXPECT_EQ(second->off_ns, 0);
  EXPECT_NEAR(static_cast<double>(second->nominal_ns - first->nominal_ns), 10e6, 1e3);
  // One of it that came before the clock's first release is none.
  ClockPhase other(0);
  of_front = of_rear = {};
  ASSERT_TRUE(other.arrived(front.due(1), front.source, of_front));
  EXPECT_FALSE(other.arrived(rear.due(0), rear.source, of_rear));
  EXPECT_EQ(other.arrived(rear.due(1), rear.source, of_rear)->number, 0u);
}

TEST(Phase, AfterADriverWasHeldUpTheGridIsWhereItWas) {
  const Sensor sensor = camera(kMs);
  ClockPhase phase(0);
  ClockPhase::Stream stream;
  for (std::uint64_t k = 0; k < 10; ++k)
    ASSERT_TRUE(phase.arrived(sensor.due(k), sensor.source, stream));
  // Frames 10 to 13 come together, half a period after the last of them was due.
  const std::int64_t at = sensor.due(13) + sensor.source.period_ns() / 2;
  EXPECT_EQ(phase.arrived(at, sensor.source, stream)->number, 13u) << "10 to 12 are given up";
  for (int late = 0; late < 3; ++late)
    EXPECT_FALSE(phase.arrived(at + 1000 * late, sensor.source, stream))
        << "and do not count twice";
  for (std::uint64_t k = 14; k < 20; ++k) {
    const auto seen = phase.arrived(sensor.due(k), sensor.source, stream);
    EXPECT_EQ(seen->number, k);
    EXPECT_EQ(seen->off_ns, 0);
  }
}

/// Losing what is overdue as time goes on finds what the next arrival would have found.
TEST(Phase, ASilentSensorLosesItsReleasesAsTimeGoesOn) {
  std::mt19937_64 random(5);
  for (int round = 0; round < 100; ++round) {
    const Sensor sensor = camera(4 * kMs);
    ClockPhase waiting(50), losing(50);
    ClockPhase::Stream of_waiting, of_losing;
    EXPECT_FALSE(losing.left_out_ns(sensor.source, of_losing)) << "nobody knows";
    int lost = 0;
    for (std::uint64_t k = 0; k < 300; ++k) {
      if (k > 0 && random() % 4 == 0) continue;  // left out
      const std::int64_t at = sensor.due(k) + static_cast<std::int64_t>(random() % (3 * kMs));
      while (of_losing.next > 0 && *losing.left_out_ns(sensor.source, of_losing) <= at) {
        ClockPhase::leave_out(of_losing);
        ++lost;
      }
      const auto expected = waiting.arrived(at, sensor.source, of_waiting);
      const auto seen = losing.arrived(at, sensor.source, of_losing);
      ASSERT_TRUE(expected && seen) << k;
      EXPECT_EQ(seen->number, k);
      EXPECT_EQ(seen->number, expected->number);
      EXPECT_EQ(seen->nominal_ns, expected->nominal_ns);
      EXPECT_EQ(seen->off_ns, expected->off_ns);
    }
    EXPECT_GT(lost, 30);
  }
}

/// It is released all the same, at once, and whoever shares its clock goes on as before.
TEST(Phase, ASensorThatIsTooFastTakesNobodyAlong) {
  for (const std::int64_t jitter : {std::int64_t{0}, 2 * kMs})
    for (const double speed : {0.99, 0.9, 0.5, 0.05}) {
      SCOPED_TRACE(speed);
      Sensor fast = camera(jitter), other = camera(jitter);
      fast.speed = speed;
      ClockPhase phase(0);
      ClockPhase::Stream of_fast, of_other;
      ASSERT_TRUE(phase.arrived(fast.due(0), fast.source, of_fast));
      const std::int64_t base = *phase.base_ns();
      ASSERT_TRUE(phase.arrived(other.due(0), other.source, of_other));
      int early = 0, off = 0, messages = 1;
      std::int64_t last = fast.due(0);
      for (std::uint64_t n = 1, k = 1; k < 120;) {
        if (other.due(k) < fast.due(n)) {
          const auto seen = phase.arrived(other.due(k), other.source, of_other);
          ASSERT_TRUE(seen && seen->number == k);
          EXPECT_EQ(seen->off_ns, 0) << k;
          ++k;
          continue;
        }
        const auto seen = phase.arrived(fast.due(n), fast.source, of_fast);
        ASSERT_TRUE(seen) << n;
        EXPECT_EQ(seen->number, n) << "each has a number of its own";
        EXPECT_LE(fast.due(n) - seen->nominal_ns, jitter) << "released when it came";
        EXPECT_LE(last, fast.due(n));
        last = fast.due(n++);
        early += seen->early ? 1 : 0;
        off += seen->off_ns > 0 ? 1 : 0;
        ++messages;
      }
      EXPECT_EQ(off, early);
      EXPECT_GT(early, messages * 8 / 10);
      // A clock of 0 ppm has the rounding of each message that was as stated.
      EXPECT_NEAR(static_cast<double>(*phase.base_ns()), static_cast<double>(base), 120 * 1.1e3);
    }
}

TEST(Phase, ASensorThatIsTooSlowOrStopsTakesNobodyAlong) {
  Sensor slow = camera(kMs), other = camera(kMs);
  slow.speed = 1.1;
  ClockPhase phase(0);
  ClockPhase::Stream of_slow, of_other;
  int off = 0;
  std::uint64_t n = 0;
  for (std::uint64_t k = 0; k < 200;) {
    if (slow.due(n) <= other.due(k)) {
      const auto seen = phase.arrived(slow.due(n++), slow.source, of_slow);
      ASSERT_TRUE(seen);
      off += seen->off_ns > 0 ? 1 : 0;
      if (n == 100) slow.start_ns += 3600 * 1000 * kMs;  // an hour
      continue;
    }
    const auto seen = phase.arrived(other.due(k), other.source, of_other);
    ASSERT_TRUE(seen && seen->number == k) << k;
    EXPECT_EQ(seen->off_ns, 0) << k;
    ++k;
  }
  EXPECT_GT(off, 80);
  const std::int64_t base = *phase.base_ns();
  ASSERT_TRUE(phase.arrived(slow.due(n), slow.source, of_slow)) << "it begins anew";
  EXPECT_EQ(*phase.base_ns(), base);
  const auto seen = phase.arrived(slow.due(n + 1), slow.source, of_slow);
  ASSERT_TRUE(seen);
  EXPECT_LE(slow.due(n + 1) - seen->nominal_ns, slow.source.period_ns());
}

/// A message out of turn is one: those after it are as stated.
TEST(Phase, WhoIsBackOnTheClocksGridIsAsStated) {
  for (const std::int64_t by : {-9 * kMs, -20 * kMs}) {
    const Sensor sensor = camera(kMs);
    ClockPhase phase(100);
    int off = 0;
    ClockPhase::Stream stream;
    for (std::uint64_t k = 0; k < 100; ++k) {
      const auto seen = phase.arrived(sensor.due(k) + (k == 50 ? by : 0), sensor.source, stream);
      ASSERT_TRUE(seen && seen->number == k) << k;
      off += seen->off_ns > 0 ? 1 : 0;
    }
    EXPECT_EQ(off, 1);
    EXPECT_EQ(stream.shift_ns, 0);
  }
}

TEST(Phase, NoArrivalMakesItOverflowOrGoBack) {
  std::mt19937_64 random(11);
  Sensor sensor = camera(kMs);
  ClockPhase phase(1000);
  ClockPhase::Stream stream;
  std::int64_t at = sensor.due(0);
  for (int i = 0; i < 20'000; ++i) {
    at += static_cast<std::int64_t>(random() % (i % 100 == 0 ? 3'600'000'000'000 : 100 * kMs));
    const std::uint64_t next = stream.next;
    const auto seen = phase.arrived(at, sensor.source, stream);
    if (!seen) continue;
    EXPECT_GE(seen->number, next);
    EXPECT_LE(seen->number, next + 1100) << "who is silent for an hour was started anew";
    EXPECT_LE(seen->nominal_ns, at);
  }
}

}  // namespace
}  // namespace xauto::runtime

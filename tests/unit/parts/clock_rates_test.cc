// SPDX-License-Identifier: Apache-2.0
// Theorem 18's watch (docs/keys.md, "Hosts") where a clock's rate is wrong, played in virtual time. What is expected is
// computed from the theorem's assumption alone: what leaves g when g's clock reads K is on h when h's clock reads K + X.
#include <algorithm>
#include <cstdint>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "parts/crossing_reader.h"

namespace xauto::parts {
namespace {

constexpr std::int64_t kMilli = 1'000'000, kMillion = 1'000'000;
constexpr std::uint64_t kReleases = 300;  // 10 s
constexpr std::int64_t kXNs = 2 * kMilli, kPeriodNs = 100 * kMilli / 3 + 1;

/// 30 Hz, which is no whole number of nanoseconds; keys of two turns.
std::int64_t release_ns(std::uint64_t k) {
  return 5 * kMilli + static_cast<std::int64_t>(k) * 100 * kMilli / 3;
}
std::int64_t key_ns(std::uint64_t k) {
  return release_ns(k) + (k % 2 == 0 ? 7 : 11) * kMilli;
}

/// Reads `off` at true time 0; `ppm` faster than true time.
struct HostClock {
  std::int64_t ppm = 0, off_ns = 0;
  [[nodiscard]] std::int64_t reads(std::int64_t real_ns) const {
    return off_ns + real_ns + real_ns / kMillion * ppm + real_ns % kMillion * ppm / kMillion;
  }
  /// The first instant at which it reads so much, or more.
  [[nodiscard]] std::int64_t when(std::int64_t reading_ns) const {
    std::int64_t low = -1000 * kMilli, high = 100'000 * kMilli;
    while (low < high) {
      const std::int64_t middle = low + (high - low) / 2;
      if (reads(middle) < reading_ns)
        low = middle + 1;
      else
        high = middle;
    }
    return low;
  }
};

struct Play {
  HostClock sender, reader;
  std::vector<std::int64_t> left_ns, way_ns;  ///< [release] by the sender's clock; in true time
  /// When it is here, by the reader's clock.
  [[nodiscard]] std::int64_t here_ns(std::uint64_t k) const {
    return reader.reads(sender.when(left_ns[k]) + way_ns[k]);
  }
  /// Whether the assumption holds of it.
  [[nodiscard]] bool kept(std::uint64_t k) const { return here_ns(k) <= key_ns(k) + kXNs; }
};

struct Told {
  std::vector<std::int64_t> at_ns;  ///< [release] when it went on, by the reader's clock
  std::vector<bool> with_message;
  /// [lost so far] when that was counted first.
  std::vector<std::int64_t> lost_at_ns = {0};
  CrossingReader::Count count;
};

/// What a part's thread does: it sleeps until something comes, or until the watch has something to do.
Told watch(const Play& play) {
  CrossingReader reader({.releases = {.period = {100'000, 3}, .offset_ns = 5 * kMilli},
                         .key_us = {7000, 11'000},
                         .x_us = kXNs / 1000},
                        0);
  reader.end(release_ns(kReleases));
  std::vector<std::pair<std::int64_t, std::uint64_t>> comes;
  for (std::uint64_t k = 0; k < kReleases; ++k) comes.emplace_back(play.here_ns(k), k);
  std::ranges::sort(comes);
  Told told;
  const auto sent = std::make_shared<const int>(1);
  std::int64_t woke_ns = INT64_MIN;
  for (std::size_t next = 0; next < comes.size() || !reader.over();) {
    const bool arrival = next < comes.size() && comes[next].first <= reader.next_ns();
    const std::int64_t now = arrival ? comes[next].first : reader.next_ns();
    if (!arrival && std::exchange(woke_ns, now) == now) {
      ADD_FAILURE() << "it wakes at " << now << " for nothing";
      break;
    }
    if (arrival) {
      const std::uint64_t k = comes[next++].second;
      (void)reader.arrive(k, {sent, release_ns(k), k}, release_ns(k), now);
    }
    reader.pass(now, [&](const detail::Envelope& envelope) {
      EXPECT_EQ(envelope.sequence, told.at_ns.size());
      told.at_ns.push_back(now);
      told.with_message.push_back(envelope.message != nullptr);
    });
    while (told.lost_at_ns.size() <= reader.count().lost) told.lost_at_ns.push_back(now);
  }
  told.count = reader.count();
  return told;
}

/// Each release that does not keep to the assumption is lost and counted, at the instant at which it is known, and no
/// other one is. Nothing goes on before its release. Returns how many were lost.
std::uint64_t hold_against_the_theorem(const Play& play) {
  const Told told = watch(play);
  EXPECT_EQ(told.at_ns.size(), kReleases);
  if (told.at_ns.size() != kReleases) return 0;
  std::uint64_t lost = 0;
  std::int64_t longest_ns = 0, latest_ns = 0, before_ns = INT64_MIN;
  for (std::uint64_t k = 0; k < kReleases; ++k) {
    const std::int64_t took_ns = play.here_ns(k) - key_ns(k), known_ns = key_ns(k) + kXNs + 1;
    EXPECT_EQ(told.with_message[k], play.kept(k)) << "release " << k;
    // In order; by the reader's clock; a loss is known the moment after K + X.
    before_ns = std::max({before_ns, release_ns(k), play.kept(k) ? play.here_ns(k) : known_ns});
    EXPECT_EQ(told.at_ns[k], before_ns) << "release " << k;
    if (play.kept(k)) {
      longest_ns = std::max(longest_ns, took_ns);
      continue;
    }
    latest_ns = std::max(latest_ns, took_ns - kXNs);
    EXPECT_EQ(told.lost_at_ns[++lost], known_ns) << "release " << k;
  }
  EXPECT_EQ(told.count.expected, kReleases);
  EXPECT_EQ(told.count.lost, lost);
  EXPECT_EQ(told.count.late, lost);  // all come, once
  EXPECT_EQ(told.count.longest_ns, longest_ns);
  EXPECT_EQ(told.count.latest_ns, latest_ns);
  EXPECT_EQ(told.count.none + told.count.twice + told.count.refused, 0U);
  return lost;
}

/// Everything leaves at its key, the latest that theorem 18 allows, and is on its way for as long.
Play steady(HostClock sender, HostClock reader, std::int64_t way_ns) {
  Play play{sender, reader, {}, std::vector<std::int64_t>(kReleases, way_ns)};
  for (std::uint64_t k = 0; k < kReleases; ++k) play.left_ns.push_back(key_ns(k));
  return play;
}

TEST(ClockRates, WithinTheStatedRateNothingIsLostAsLongAsXCoversIt) {
  constexpr std::int64_t kRho = 50;
  // Two clocks are apart by what they were at first, and by as much as both rates make of ten seconds.
  const std::int64_t apart_ns = 2 * kRho * release_ns(kReleases + 1) / kMillion;
  for (const std::int64_t sender : {-kRho, std::int64_t{0}, kRho})
    for (const std::int64_t reader : {-kRho, std::int64_t{0}, kRho})
      for (const std::int64_t off : {-400'000, 0, 400'000}) {
        const std::int64_t way = kXNs - std::max<std::int64_t>(off, 0) - apart_ns - 1000;
        EXPECT_EQ(hold_against_the_theorem(steady({sender, 0}, {reader, off}, way)), 0U)
            << sender << " and " << reader << " ppm, off by " << off;
      }
}

TEST(ClockRates, ExactlyXIsInTimeAndANanosecondMoreIsNot) {
  EXPECT_EQ(hold_against_the_theorem(steady({}, {}, kXNs)), 0U);
  EXPECT_EQ(hold_against_the_theorem(steady({}, {}, kXNs + 1)), kReleases);
}

/// A reader's clock that is fast, or a sender's that is slow: from the instant on at which they are apart by what is left
/// of X each message is lost, and the first is named within a period.
TEST(ClockRates, OutsideOfItTheFirstLossComesWhenTheRestOfXIsUsedUp) {
  for (const std::int64_t ppm : {300, 1000, 100'000}) {
    for (const std::int64_t way_ns : {std::int64_t{0}, kMilli, kXNs - 1}) {
      for (const bool slow_sender : {false, true}) {
        const Play play =
            slow_sender ? steady({-ppm, 0}, {0, 0}, way_ns) : steady({0, 0}, {ppm, 0}, way_ns);
        const std::uint64_t lost = hold_against_the_theorem(play);
        ASSERT_GT(lost, 0U);
        const Told told = watch(play);
        const auto first = std::ranges::find(told.with_message, false) - told.with_message.begin();
        EXPECT_EQ(lost, kReleases - static_cast<std::uint64_t>(first));  // none is in time again
        // By the closed form; a per cent more or less of ppm is what a fast second is to a true one.
        const double rest_ns = static_cast<double>(kXNs - way_ns);
        const double used_up_ns = rest_ns * 1e6 / static_cast<double>(ppm);
        const auto told_ns = static_cast<double>(told.lost_at_ns[1]);
        const double more = 1 + static_cast<double>(ppm) * 1e-6;
        EXPECT_GE(told_ns, used_up_ns / more);
        EXPECT_LE(told_ns, used_up_ns * more * more + 2.0 * kPeriodNs + kXNs);
      }
    }
  }
}

/// The other way round nobody is late: what comes too soon waits for its release, by the reader's clock.
TEST(ClockRates, ASenderWhoseClockIsFastLosesNothing) {
  for (const std::int64_t ppm : {50, 1000, 100'000})
    for (const bool slow_reader : {false, true}) {
      const Play play =
          slow_reader ? steady({0, 0}, {-ppm, 0}, kMilli) : steady({ppm, 0}, {0, 0}, kMilli);
      EXPECT_EQ(hold_against_the_theorem(play), 0U) << ppm;
    }
}

/// Clocks, ways and what a sender has left of its window at random: messages overtake each other, and X is kept, and not.
TEST(ClockRates, WhateverClocksAndWaysDoTheWatchSaysWhatTheTheoremSays) {
  std::mt19937 dice(18);
  const auto roll = [&](std::int64_t low, std::int64_t high) {
    return std::uniform_int_distribution<std::int64_t>(low, high)(dice);
  };
  std::uint64_t lost = 0, plays_that_kept = 0;
  for (int times = 0; times < 300; ++times) {
    const std::int64_t most_ppm = times % 3 == 0 ? 50 : 20'000, most_way = roll(0, 2) * kMilli;
    Play play = steady({roll(-most_ppm, most_ppm), roll(-kMilli, kMilli)},
                       {roll(-most_ppm, most_ppm), roll(-kMilli, kMilli)}, 0);
    for (std::uint64_t k = 0; k < kReleases; ++k) {
      play.left_ns[k] -= roll(0, key_ns(k) - release_ns(k));
      play.way_ns[k] = roll(0, 10) == 0 ? roll(0, 40 * most_way) : roll(0, most_way);
    }
    const std::uint64_t of_this = hold_against_the_theorem(play);
    lost += of_this;
    plays_that_kept += of_this == 0 ? 1 : 0;
    if (HasFailure()) return;
  }
  EXPECT_GT(lost, 1000U);
  EXPECT_GT(plays_that_kept, 30U);
}

}  // namespace
}  // namespace xauto::parts

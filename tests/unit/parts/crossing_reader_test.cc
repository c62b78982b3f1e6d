// SPDX-License-Identifier: Apache-2.0
#include "parts/crossing_reader.h"

#include <algorithm>
#include <optional>

#include <gtest/gtest.h>

#include "parts/crossing_message.h"
#include "parts/crossings.h"

namespace xauto::parts {
namespace {

constexpr std::int64_t kMs = 1'000'000;

/// Releases every 10 ms from 1 ms on, keys at 3 and 4 ms, X of 2 ms.
CrossingReader::Rule rule() {
  return {
      .releases = {.period = {10'000, 1}, .offset_ns = kMs}, .key_us = {3000, 4000}, .x_us = 2000};
}
std::int64_t nominal(std::uint64_t k) {
  return kMs + static_cast<std::int64_t>(k) * 10 * kMs;
}
/// By hand: nominal + key + X.
std::int64_t by(std::uint64_t k) {
  return nominal(k) + (k % 2 == 0 ? 5 : 6) * kMs;
}
detail::Envelope message(std::uint64_t k) {
  return {std::make_shared<const int>(static_cast<int>(k)), nominal(k), k};
}

struct Reader {
  explicit Reader(const CrossingReader::Rule& of = rule()) : reader(of, 0) {}
  CrossingReader reader;
  std::vector<detail::Envelope> got = {};
  void pass(std::int64_t now) {
    reader.pass(now, [this](const detail::Envelope& e) { got.push_back(e); });
  }
  bool arrive(std::uint64_t k, std::int64_t now) {
    return reader.arrive(k, message(k), nominal(k), now);
  }
};

/// In words: release k has a result here if one of its messages came by its X, else a tombstone; all in order.
TEST(CrossingReader, WhatIsHereByXGoesOnInOrderAndTheRestIsLost) {
  // Of each of three releases a message comes in the first instant of this list, and another one in the second. 9: none.
  const std::vector<std::pair<int, int>> ways = {{0, 9}, {1, 9}, {2, 9}, {3, 9}, {9, 9},
                                                 {0, 0}, {0, 3}, {2, 3}, {3, 3}};
  const auto instant = [](std::uint64_t k, int way) {
    const std::int64_t at[] = {nominal(k), by(k), by(k) + 1, by(k) + 25 * kMs};
    return at[way];
  };
  for (std::size_t code = 0; code < ways.size() * ways.size() * ways.size(); ++code) {
    for (const std::int64_t look : {1 * kMs, 100 * kMs}) {
      std::vector<std::pair<std::int64_t, std::uint64_t>> comes;
      std::vector<bool> in_time;
      std::uint64_t late = 0, twice = 0;
      std::size_t rest = code;
      for (std::uint64_t k = 0; k < 3; ++k, rest /= ways.size()) {
        const auto [first, second] = ways[rest % ways.size()];
        for (const int way : {first, second})
          if (way != 9) comes.emplace_back(instant(k, way), k);
        in_time.push_back(first <= 1);
        late += first == 2 || first == 3 ? 1 : 0;
        twice += first != 9 && second != 9 ? 1 : 0;
      }
      std::ranges::sort(comes);
      Reader r;
      r.reader.end(nominal(3));
      std::size_t next = 0;
      for (std::int64_t now = 0; now <= 100 * kMs; now += look) {
        for (; next < comes.size() && comes[next].first <= now; ++next)
          (void)r.arrive(comes[next].second, comes[next].first);
        r.pass(now);
      }
      ASSERT_EQ(r.got.size(), 3U) << code;
      for (std::uint64_t k = 0; k < 3; ++k) {
        ASSERT_EQ(r.got[k].sequence, k) << code;
        ASSERT_EQ(r.got[k].message != nullptr, in_time[k]) << code << " release " << k;
        if (in_time[k]) {
          ASSERT_EQ(*static_cast<const int*>(r.got[k].message.get()), static_cast<int>(k));
        }
      }
      const CrossingReader::Count& count = r.reader.count();
      ASSERT_EQ(count.expected, 3U);
      ASSERT_EQ(count.lost, static_cast<std::uint64_t>(std::ranges::count(in_time, false))) << code;
      ASSERT_EQ(count.late, late) << code;
      ASSERT_EQ(count.twice, twice) << code;
      ASSERT_TRUE(r.reader.over());
      ASSERT_EQ(r.reader.next_ns(), INT64_MAX);
    }
  }
}

TEST(CrossingReader, NobodyWaitsLongerThanX) {
  Reader r;
  EXPECT_EQ(r.reader.next_ns(), by(0) + 1);
  r.pass(by(0));
  EXPECT_TRUE(r.got.empty());
  r.pass(by(0) + 1);
  ASSERT_EQ(r.got.size(), 1U);
  EXPECT_EQ(r.got[0].message, nullptr);
  EXPECT_EQ(r.reader.next_ns(), by(1) + 1);
  EXPECT_EQ(r.reader.last_lost(), 1U);
}

TEST(CrossingReader, OneThatOvertakesWaitsForTheOlderOne) {
  CrossingReader::Rule with = rule();
  with.x_us = 12'000;
  Reader r(with);
  EXPECT_TRUE(r.arrive(1, nominal(1) + kMs));
  r.pass(nominal(1) + kMs);
  EXPECT_TRUE(r.got.empty());
  EXPECT_TRUE(r.arrive(0, nominal(1) + 2 * kMs));
  r.pass(nominal(1) + 2 * kMs);
  ASSERT_EQ(r.got.size(), 2U);
  EXPECT_EQ(r.got[1].sequence, 1U);
}

/// A sender whose clock is ahead.
TEST(CrossingReader, NothingGoesOnBeforeItsRelease) {
  Reader r;
  EXPECT_TRUE(r.arrive(0, nominal(0) - 3 * kMs));
  EXPECT_TRUE(r.arrive(1, nominal(0) - 2 * kMs));
  r.pass(nominal(0) - 1);
  EXPECT_TRUE(r.got.empty());
  EXPECT_EQ(r.reader.next_ns(), nominal(0));
  r.pass(nominal(0));
  EXPECT_EQ(r.got.size(), 1U);
  EXPECT_EQ(r.reader.next_ns(), nominal(1));
  r.pass(nominal(1) - 1);
  EXPECT_EQ(r.got.size(), 1U);
  r.pass(nominal(1));
  ASSERT_EQ(r.got.size(), 2U);
  EXPECT_NE(r.got[1].message, nullptr);
  EXPECT_EQ(r.reader.count().lost, 0U);
}

TEST(CrossingReader, WhatTheSenderHadNoResultOfIsNoLossOfTheWay) {
  Reader r;
  EXPECT_TRUE(r.reader.arrive(0, {nullptr, detail::kOffNs, 2}, nominal(2), kMs));
  r.pass(nominal(2));
  ASSERT_EQ(r.got.size(), 3U);
  EXPECT_EQ(r.got[1].origin_ns, detail::kOffNs);
  EXPECT_EQ(r.reader.count().lost, 0U);
  EXPECT_EQ(r.reader.count().none, 3U);
}

TEST(CrossingReader, ReleasesThatNoGridHasAreRefused) {
  Reader r;
  EXPECT_FALSE(r.reader.arrive(1, message(1), nominal(1) + 1, 0));
  EXPECT_FALSE(r.reader.arrive(kMostWaiting, message(kMostWaiting), nominal(kMostWaiting), 0));
  detail::Envelope far = message(1);
  far.sequence = UINT64_MAX / 3;
  EXPECT_FALSE(r.reader.arrive(far.sequence, far, 0, 0));
  r.reader.end(nominal(2));
  EXPECT_FALSE(r.arrive(2, 0));
  EXPECT_EQ(r.reader.count().refused, 3U);
  EXPECT_TRUE(r.arrive(1, 0));
}

TEST(CrossingReader, WhoComesLaterReadsFromThere) {
  CrossingReader reader(rule(), 5);
  EXPECT_FALSE(reader.arrive(4, message(4), nominal(4), nominal(5)));
  EXPECT_EQ(reader.next_ns(), by(5) + 1);
  EXPECT_EQ(reader.count().expected + reader.count().refused + reader.count().twice, 0U);
}

TEST(CrossingReader, AnUrgentOneHasItsOwnKey) {
  CrossingReader::Rule with = rule();
  with.urgent_by_us = 1000;
  CrossingReader reader(with, 0);
  detail::Envelope urgent = message(0);
  urgent.urgent = true;
  EXPECT_FALSE(reader.arrive(0, urgent, nominal(0), by(0) - kMs + 1));
  std::vector<detail::Envelope> got;
  reader.pass(by(0), [&](const detail::Envelope& e) { got.push_back(e); });
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0].message, nullptr);
  EXPECT_EQ(reader.count().lost, 1U);
  EXPECT_EQ(reader.count().late, 1U);
  EXPECT_EQ(reader.count().none, 0U);
}

TEST(PartStart, TheFirstReleaseIsTheFirstAfterItBegan) {
  const runtime::Grid::Source thirds{.period = {100'000, 3}, .offset_ns = 5 * kMs};
  for (std::int64_t from = 0; from < 300 * kMs; from += 777'777) {
    std::uint64_t k = 0;  // the long way
    while (thirds.due_ns(k) < from) ++k;
    EXPECT_EQ((PartStart{0, from}.first(thirds)), k) << from;
    std::uint64_t shifted = 0;
    while (thirds.due_ns(shifted) - 2 * kMs < from) ++shifted;
    EXPECT_EQ((PartStart{0, from}.first(thirds, 2 * kMs)), shifted) << from;
  }
}

TEST(CrossingMessage, WhatIsEncodedIsDecoded) {
  CrossingHead head{
      .run = 7, .first = 41, .number = 41, .nominal_ns = 12, .payload = true, .urgent = true};
  head.origins.fill(kNoOrigin);
  head.origins[3] = 99;
  const std::vector<std::byte> payload(5, std::byte{6});
  const auto bytes = encode(head, payload);
  const auto back = decode(bytes);
  ASSERT_TRUE(back.has_value());
  EXPECT_EQ(back->head, head);
  EXPECT_EQ(back->payload, payload);
  head = {.run = 7, .first = 2, .number = 9, .nominal_ns = 1, .reason = detail::kSkippedNs};
  head.origins.fill(kNoOrigin);
  EXPECT_EQ(decode(encode(head, {}))->head, head);
}

TEST(CrossingMessage, AnythingElseIsNone) {
  CrossingHead head{.run = 1, .first = 3, .number = 3, .payload = true};
  head.origins.fill(kNoOrigin);
  const auto good = encode(head, {});
  ASSERT_TRUE(decode(good).has_value());
  for (std::size_t size = 0; size < good.size(); ++size)
    EXPECT_FALSE(decode(std::span(good).first(size)).has_value());
  // Magic, an unknown flag, both reasons, first above number, a range with a payload, many origins, a byte that is 0.
  for (const auto& [at, value] : std::vector<std::pair<std::size_t, int>>{{0, 0},
                                                                          {4, 16 + 1},
                                                                          {4, 12},
                                                                          {4, 5},
                                                                          {16, 4},
                                                                          {16, 2},
                                                                          {40, 25},
                                                                          {40, 1},
                                                                          {44, 1},
                                                                          {39, 255}}) {
    auto bad = good;
    bad[at] = static_cast<std::byte>(value);
    EXPECT_FALSE(decode(bad).has_value()) << at;
  }
  auto tombstone = encode({.run = 1, .first = 3, .number = 3}, {});
  tombstone.push_back(std::byte{1});
  EXPECT_FALSE(decode(tombstone).has_value());
}

}  // namespace
}  // namespace xauto::parts

// SPDX-License-Identifier: Apache-2.0
#include "releases/clock_starts.h"

#include <cstdlib>
#include <set>

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

Grid three_clocks() {
  Grid grid;
  grid.clock_ppm = {0, 5000, 100};
  const auto source = [](std::int64_t period_us, std::size_t clock) {
    Grid::Source made;
    made.period = {period_us, 1};
    made.clock = clock;
    return made;
  };
  grid.sources = {source(20'000, 0), source(100'000, 1), source(40'000, 2), source(60'000, 2)};
  return grid;
}

TEST(ClockStarts, TheFirstClockIsTheRunsAndTheOthersGoOverTheirWholePattern) {
  std::int64_t least[3] = {INT64_MAX, INT64_MAX, INT64_MAX}, most[3] = {};
  std::set<std::int64_t> ppm[3];
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    const std::vector<ClockStart> starts = clocks_apart(three_clocks(), seed);
    ASSERT_EQ(starts.size(), 3);
    for (std::size_t c = 0; c < 3; ++c) {
      least[c] = std::min(least[c], starts[c].phase_ns);
      most[c] = std::max(most[c], starts[c].phase_ns);
      ppm[c].insert(starts[c].ppm);
    }
  }
  EXPECT_EQ(most[0], 0);
  EXPECT_EQ(ppm[0], std::set<std::int64_t>{0});
  // 100 ms, and 40 and 60 ms together 120.
  EXPECT_GE(least[1], 0);
  EXPECT_LT(least[1], 5'000'000);
  EXPECT_GT(most[1], 95'000'000);
  EXPECT_LT(most[1], 100'000'000);
  EXPECT_LT(least[2], 6'000'000);
  EXPECT_GT(most[2], 114'000'000);
  EXPECT_LT(most[2], 120'000'000);
  EXPECT_EQ(ppm[1], (std::set<std::int64_t>{-5000, 5000}));
  EXPECT_EQ(ppm[2], (std::set<std::int64_t>{-100, 100}));
}

TEST(ClockStarts, OneSeedOneStart) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed)
    for (std::size_t c = 0; c < 3; ++c)
      EXPECT_EQ(clocks_apart(three_clocks(), seed)[c].phase_ns,
                clocks_apart(three_clocks(), seed)[c].phase_ns);
}

TEST(ClockStarts, PeriodsThatShareNothingHaveNoLongPattern) {
  Grid grid = three_clocks();
  grid.sources[3].period = {59'999'999, 1};
  grid.sources.push_back(grid.sources[3]);
  grid.sources.back().period = {3'599'999'989, 1};
  for (std::uint64_t seed = 1; seed <= 20; ++seed)
    EXPECT_LT(clocks_apart(grid, seed)[2].phase_ns, 1'000'000'000);
}

/// The certificate's words (docs/keys.md): releases are |period| * (1 +- ppm / 10^6) apart; here to the nanosecond.
TEST(ClockStarts, ReleasesAreAsFarApartAsStatedAndNoDriftIsLost) {
  Grid grid = three_clocks();
  grid.sources[1].period = {100'000, 3};
  for (const std::int64_t ppm : {5000, -5000, 0}) {
    const ClockStart start{.phase_ns = 7'000, .ppm = ppm};
    const auto due = [&](std::uint64_t k) { return start.due_ns(grid.sources[1].due_ns(k)); };
    EXPECT_EQ(due(0), 7'000);
    const std::int64_t apart = 33'333'333 + 33'333'333 * ppm / 1'000'000;
    for (std::uint64_t k = 0; k < 1000; ++k) EXPECT_LE(std::abs(due(k + 1) - due(k) - apart), 2);
    // An hour: 108 000 releases.
    EXPECT_EQ(due(108'000), 7'000 + 3'600'000'000'000 + 3'600'000 * ppm);
  }
}

}  // namespace
}  // namespace xauto::runtime

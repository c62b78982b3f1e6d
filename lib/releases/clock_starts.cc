// SPDX-License-Identifier: Apache-2.0
#include "releases/clock_starts.h"

#include <algorithm>
#include <numeric>
#include <random>

namespace xauto::runtime {
namespace {

constexpr std::uint64_t kLongestNs = 1'000'000'000;  ///< runs are of seconds

/// After which the clock's releases repeat.
std::uint64_t pattern_ns(const Grid& grid, std::size_t clock) {
  std::uint64_t all = 1;
  for (const Grid::Source& source : grid.sources) {
    if (source.clock != clock) continue;
    const auto period = static_cast<std::uint64_t>(std::max<std::int64_t>(1, source.period_ns()));
    const std::uint64_t times = period / std::gcd(all, period);
    if (all > kLongestNs / times) return kLongestNs;
    all *= times;
  }
  return all;
}

}  // namespace

std::vector<ClockStart> clocks_apart(const Grid& grid, std::uint64_t seed) {
  std::mt19937_64 random(
      seed);  // the standard says what it draws; of its distributions it does not
  std::vector<ClockStart> starts(grid.clock_ppm.size());
  for (std::size_t c = 1; c < starts.size(); ++c) {
    // Whole microseconds: as they are told.
    starts[c].phase_ns = static_cast<std::int64_t>(
                             random() % std::max<std::uint64_t>(1, pattern_ns(grid, c) / 1000)) *
                         1000;
    starts[c].ppm = random() % 2 == 0 ? grid.clock_ppm[c] : -grid.clock_ppm[c];
  }
  return starts;
}

}  // namespace xauto::runtime

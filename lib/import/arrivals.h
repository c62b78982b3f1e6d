// SPDX-License-Identifier: Apache-2.0
// Rates out of instants.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "model/app.h"

namespace xauto::import {

/// Releases as they came: which release each instant was, and when that was due.
struct Grid {
  Period period;
  std::vector<std::int64_t> release;     ///< [instant] number of the release, growing
  std::vector<std::int64_t> nominal_ns;  ///< [release]
};

inline constexpr std::size_t kMaxReleases = 4'000'000;

/// A period in ns as what somebody meant: a whole rate in Hz within `tolerance` (a part), or whole microseconds, at least
/// `round_us`.
[[nodiscard]] Period meant_period(double period_ns, double tolerance, std::int64_t round_us);

/// Of a timer that was made at `made_ns`: release k is due k + 1 periods later, and called no earlier. Its clock may run
/// otherwise than the trace's, a little. None: no plausible period, or too many releases.
[[nodiscard]] std::optional<Grid> timer_grid(const std::vector<std::int64_t>& starts_ns,
                                             std::int64_t made_ns, std::int64_t period_ns);

/// Of messages whose rate nobody states: at least three. None: fewer, or no rate in them.
[[nodiscard]] std::optional<Grid> seen_grid(const std::vector<std::int64_t>& instants_ns);

/// Where no tick divides all periods (Components::ticks_per_us), those whose fractions are the finest become whole
/// microseconds.
void settle_periods(AppSpec& app);

}  // namespace xauto::import

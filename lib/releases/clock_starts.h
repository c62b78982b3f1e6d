// SPDX-License-Identifier: Apache-2.0
// A run that tries phases (`--phases`). Without it every clock begins at one instant and runs as ours does, so a run sees
// one phase of all that the certificate speaks of (docs/keys.md, "Words").
#pragma once

#include <cstdint>
#include <vector>

#include "grid/grid.h"

namespace xauto::runtime {

/// What a clock's sources release is due at phase + (1 + ppm / 10^6) * grid.
struct ClockStart {
  std::int64_t phase_ns = 0;
  std::int64_t ppm = 0;  ///< above 0: it is slow
  [[nodiscard]] std::int64_t due_ns(std::int64_t grid_ns) const {
    return phase_ns + grid_ns +
           static_cast<std::int64_t>(static_cast<__int128>(grid_ns) * ppm / 1'000'000);
  }
};

/// [clock] The first begins with the run, and is true. Each other one begins within the time after which its sources'
/// releases repeat, a second at most, and is as far off as app.json states, slow or fast: both by `seed`.
[[nodiscard]] std::vector<ClockStart> clocks_apart(const Grid& grid, std::uint64_t seed);

}  // namespace xauto::runtime

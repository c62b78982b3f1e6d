// SPDX-License-Identifier: Apache-2.0
// Demand bound: whether one XPU can serve jobs of several domains, whatever the phases.
//
//   dbf_g(t) = max over the jobs s of domain g on the XPU of the work of its jobs whose windows lie
//              in [a_s, a_s + t], its own pattern over the hyperperiod
//   sum over g of dbf_g(t) + max {C_j : its blocking lasts > t} <= t   at every step t
//
// up to the first t by which everything that arrives in [0, t) has been served: a longer interval
// that fails has a shorter one at its end that fails too. Processor demand: Baruah, Rosier, Howell
// 1990; the patterns make it exact for windows, since phases are free.
#pragma once

#include <cstdint>
#include <vector>

#include "solver/keys/problem.h"

namespace xauto::solver::keys {

struct WindowedJob {
  Tick arrival = 0;  ///< in [0, period of the pattern)
  Tick length = 0;   ///< d - a
  Tick work = 0;     ///< WCET with charges
};

/// What one domain does on the XPU, again and again.
struct Pattern {
  Tick period = 0;
  std::int64_t ppm = 0;
  /// A job may arrive by so much later than its `arrival` says, each by another amount: two may be
  /// nearer than they look.
  Tick slip = 0;
  bool once = false;  ///< each of its jobs at most once in any interval: it loads nothing for long
  Tick deepest = 0;   ///< largest d; a clock that drifts shifts releases against a and d by so much
  std::vector<WindowedJob> jobs;
};

struct Blocking {
  Tick until =
      0;  ///< d_j - its earliest start as the last that may start: it blocks intervals shorter than this
  Tick work = 0;
};

/// The interval in which least is left.
struct Tightest {
  Tick length = 0, demand = 0;
};

/// False also where it takes too many steps to know.
[[nodiscard]] bool demand_fits(std::vector<Pattern>& patterns,
                               const std::vector<Blocking>& blocking, Tightest* tightest = nullptr);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Demand bound: whether one XPU can serve jobs of several domains, whatever the phases.
//
//   dbf_g(t) = max over the jobs s of domain g on the XPU of the work of its jobs whose windows lie
//              in [a_s, a_s + t], its own pattern over the hyperperiod
//   sum over g of dbf_g(t) + max {C_j : d_j - e_j > t} (not preemptive) <= t   at every step t
//
// up to the first t by which everything that arrives in [0, t) has been served: a longer interval
// that fails has a shorter one at its end that fails too. Processor demand: Baruah, Rosier, Howell
// 1990; the patterns make it exact for windows, since phases are free.
#pragma once

#include <cstdint>
#include <vector>

#include "solver/steady/problem.h"

namespace xauto::solver::steady {

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

/// A function of the length of an interval: `value` from `length` on. Both rise.
struct Step {
  Tick length, value;
};
/// dbf_g of one pattern, for lengths up to `horizon`; sorts its jobs. Takes of `budget`, a step each. False:
/// that does not suffice.
[[nodiscard]] bool demand_curve(Pattern& g, Tick horizon, std::int64_t& budget,
                                std::vector<Step>& due);

struct Blocking {
  Tick until = 0;  ///< d_j - e_j: it blocks intervals shorter than this
  Tick work = 0;
  int pattern =
      -1;  ///< whose it is, where it is known by how much others of that are then in the interval
  Tick beside = 0;  ///< at most
};

/// By how much demand and blocking together are above the length of an interval.
class Lack {
 public:
  /// False: the demand alone is above some length, or it takes too many steps to know.
  [[nodiscard]] bool find(std::vector<Pattern>& patterns, std::vector<Blocking> blocking);
  /// The most of all intervals that are not shorter than `length`; 0: never. It does not rise.
  [[nodiscard]] Tick from(Tick length) const;

 private:
  struct Over {
    Tick length, value;  ///< the demand from here on
    Tick most;           ///< at this step and all later ones
  };
  std::vector<Over> over_;
  std::vector<Blocking> blocking_;
  Tick none_from_ = 0;  ///< no lack at this length or a longer one
};

/// The interval in which least is left.
struct Tightest {
  Tick length = 0, demand = 0;
};

/// False also where it takes too many steps to know.
[[nodiscard]] bool demand_fits(std::vector<Pattern>& patterns,
                               const std::vector<Blocking>& blocking, Tightest* tightest = nullptr);

}  // namespace xauto::solver::steady

// SPDX-License-Identifier: Apache-2.0
// One case of bench_keys, measured: the solver in a process of its own, the check of its answer,
// and what else one could do.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "solver/keys/solve.h"

#include "bench/keys/generate.h"
#include "bench/keys/rivals.h"

namespace xauto::bench {

struct Asked {
  solver::keys::Aim aim = solver::keys::Aim::kLargest;
  double time_limit_s = 10;
  int threads = 2;
  std::uint64_t seed = 1;
  double annealer_s = -1;  ///< below 0: as the solver; 0: none
  bool rivals = true;
  Plays plays;
};

struct Beside {
  std::string name;
  double load = 0;  ///< of its fullest XPU
  bool backlog = false;
  double ratio = 0;     ///< largest of observed / our worst case, over the chains
  bool breaks = false;  ///< that is above 1, or the backlog grows
  bool misses = false;  ///< some deadline; or the backlog grows
};

struct Measured {
  std::string outcome;  ///< "policy", "overload", "unknown"
  double first_ms = 0;  ///< until the first policy; of an overload the whole
  double solve_s = 0, cpu_s = 0;
  double memory_mib = 0;  ///< most that the solver's process had
  std::int64_t evaluations = 0;
  std::int64_t jobs =
      0;  ///< per hyperperiod, all clocks together; 0: it does not fit, or never ends
  solver::keys::Totals totals, bounds;  ///< of the policy; of no policy less
  double objective = 0;                 ///< of both what was asked for; of a mix the sum
  double bound = 0;                     ///< the same of the lower bounds
  bool misses = false;                  ///< some deadline, in the worst case
  double check_ms = 0;
  std::optional<double> annealed;  ///< its objective; none: it found nothing
  double annealer_first_ms = 0;
  std::int64_t annealer_evaluations = 0;
  double ours_ratio = 0;  ///< as Beside::ratio, of our own keys: never above 1
  std::int64_t late = 0;  ///< of our jobs, after their keys, in the plays
  std::vector<Beside> beside;
};

[[nodiscard]] Result<Measured> measure(const RatedCase& made, const Asked& asked);

}  // namespace xauto::bench

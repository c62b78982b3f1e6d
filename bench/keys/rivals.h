// SPDX-License-Identifier: Apache-2.0
// What else one could do with an app of several rates, played beside a policy of keys: the same
// placement under other rules, and everybody on its fastest type.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::bench {

struct Rival {
  std::string name;
  std::vector<int> xpu;            ///< [xnode]
  std::vector<std::int64_t> rank;  ///< [xnode] the smaller goes first; equal: first come
  double load = 0;                 ///< of the fullest XPU
};

/// "fixed": priorities that solver/solve.h finds for one release of everything, placed as `ours`;
/// "rm": the shorter period first; "fcfs": who is ready first; "fastest": everybody on its fastest
/// type, shorter periods first.
[[nodiscard]] Result<std::vector<Rival>> rivals(const AppSpec& app, const Platform& platform,
                                                const Policy& ours);

struct Observed {
  std::vector<double> longest_us;  ///< [chain] of all plays
  bool backlog = false;            ///< it grew: it does not keep up
  std::int64_t jobs = 0, late = 0;
};

struct Plays {
  int count = 8;                ///< each with a seed of its own; half of them with random times
  std::int64_t jobs = 100'000;  ///< about so many in each
  std::uint64_t seed = 1;
};

/// What the player sees, with jitter, phases and drift.
[[nodiscard]] Result<Observed> observe(const AppSpec& app, const Platform& platform,
                                       const Policy& ours, const Rival& rival, const Plays& plays);
/// Of our own keys.
[[nodiscard]] Result<Observed> observe(const AppSpec& app, const Platform& platform,
                                       const Policy& ours, const Plays& plays);

}  // namespace xauto::bench

// SPDX-License-Identifier: Apache-2.0
// Chains: how long a release takes at most to reach a chain's end, from keys and holds alone.
//
// Inside a component: d of the last XNode - (offset of the source - phase).
// Through a sample u -> v: v reads when it starts, not before its release + e, its earliest start. Where u's result is
// on its way for a time, d_u is longer by that.
//   One domain:  the first activation n of v with  release(n) + e_v(n) >= release(k) + d_u(k).
//                Where v's release may be urgent, it may start sooner. Where the clock drifts several may
//                be the first: n is released at most a period - e_v(n-1) after u's end, too.
//   Two domains: from d_u to v's release + e at most the largest distance of two of them.
#pragma once

#include <cstdint>

#include "solver/keys/problem.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

/// The least real distance of two releases that are `length` of their clock apart, which may be below 0.
[[nodiscard]] Tick least_distance(Tick length, std::int64_t ppm);

/// Whether it is among those of which the largest worst case counts.
[[nodiscard]] inline bool is_counted(const Problem& problem, const Chain& chain) {
  return !problem.deadlines || chain.deadline != kNoTick;
}
/// Whether anybody asks for its worst case: it counts there, or in the sum.
[[nodiscard]] inline bool is_asked_for(const Problem& problem, const Chain& chain) {
  return is_counted(problem, chain) || chain.weight > 0;
}

/// The worst of its ways, in ticks. d and e of `w` are read. `urgent`: of a release that the
/// chain's source marks so; the source may.
[[nodiscard]] Tick worst_case(const Problem& problem, const Chain& chain, const Windows& w,
                              bool urgent = false);
/// Numbers of releases; of any, also below 0 and beyond the hyperperiod.
struct Releases {
  std::int64_t first = 0, last = kForever;
};
/// The same for one way, of these releases.
[[nodiscard]] Tick worst_case(const Problem& problem, const Chain& chain, const Path& path,
                              const Windows& w, bool urgent = false, const Releases& of = {});

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Chains: how long a release takes at most to reach a chain's end, from keys and holds alone; and
// what no policy can do better.
//
// Inside a component: d of the last XNode - (offset of the source - phase).
// Through a sample u -> v: v reads when it starts, not before its release + hold.
//   One domain:  the first activation n of v with  release(n) + hold_v(n) >= release(k) + d_u(k).
//   Two domains: from d_u to v's release + hold at most the largest distance of two of them.
#pragma once

#include <vector>

#include "solver/steady/problem.h"
#include "solver/steady/windows.h"
#include "solver/until.h"

namespace xauto::solver::steady {

/// The worst of its ways, in ticks. d and hold of `w` are read.
[[nodiscard]] Tick worst_case(const Problem& problem, const Chain& chain, const Windows& w);
/// The same for one way; `last` (may be null): the slot of its last job.
[[nodiscard]] Tick worst_case(const Problem& problem, const Chain& chain, const Path& path,
                              const Windows& w);

/// [chain] in ticks: the worst case of no policy is shorter.
///
/// A release of one component takes at least version 1's bound of the ancestors of its last XNode.
/// Through samples: the least WCETs behind each sample more; and one start of a reader of period T
/// serves, again and again, at least ceil(T / T_u) releases of a source of period T_u, of which the
/// oldest waits (ceil(T / T_u) - 1) T_u longer than the newest.
[[nodiscard]] std::vector<Tick> lower_bounds(const Problem& problem, const AppSpec& app,
                                             const Platform& platform, const Objectives& wishes,
                                             const Until& until = {});

}  // namespace xauto::solver::steady

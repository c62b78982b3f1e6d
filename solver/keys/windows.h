// SPDX-License-Identifier: Apache-2.0
// Windows: from keys and holds to windows [a, d] of every job, and what windows cost on an XPU: who
// may start by preempting, and by whom a job may be blocked, where not any number may have started.
//
//   a = max of  d_u + transfer     over predecessors u
//               J + offset - phase of the sources heard (roots)
//               hold
//               D - N T            (entries of a module; D: largest d in it, N activations before)
//   e = max of  hold, e_u          over predecessors u on this host: no execution starts before it
#pragma once

#include <vector>

#include "model/policy.h"
#include "solver/keys/problem.h"

namespace xauto::solver::keys {

/// By slot, ticks after the nominal release.
struct Windows {
  std::vector<Tick> a, d;
  std::vector<Tick> hold;  ///< 0: none
  std::vector<Tick> e;     ///< earliest start
};

/// Keys and holds of a policy for this app; `a` and `e` are 0. Its arrays divide the activations.
[[nodiscard]] Windows keys_and_holds(const Problem& problem, const Policy& policy);
/// Fills `a` and `e` of the domain from d and hold.
void derive_ready(const Problem& problem, int domain, const std::vector<int>& xpu, Windows& w);

/// The windows of urgent releases, as if each activation were one: `u` is `w` but for the XNodes that
/// hear of the urgent source. Their keys and holds are earlier by urgent_by, a hold by at most itself.
/// `a` follows from that, and from what does not move: the arrival, predecessors that do not hear of
/// the source, the module's earlier activations, the XNode's activation before.
void derive_urgent(const Problem& problem, const std::vector<int>& xpu, const Windows& w,
                   Windows& u);
/// What is missing most, so that each urgent job has its WCET in its window, and no key falls where
/// an urgent release follows another one. 0: nothing; `xnode` is whose it is.
[[nodiscard]] Tick urgent_shortfall(const Problem& problem, const std::vector<int>& xpu,
                                    const Windows& w, const Windows& u, int& xnode);

/// By slot: what a job pays beyond its WCET.
struct Charges {
  std::vector<char> preempts;  ///< it may start by preempting: charged the XPU's cost
  std::vector<Tick>
      blocked_by;  ///< longest job that may have started as the last before it is ready
  /// Earliest start, after the nominal release, as the last that the XPU's levels allow; kForever: never, or
  /// nobody on the XPU may have to wait then.
  std::vector<Tick> last_start;
  std::vector<char> urgent_preempts;  ///< [xnode] as preempts, of an urgent release
};

/// Job (i, n) can preempt (j, m) of its XPU iff (j, m) may have started before (i, n) is ready and
/// has a larger key, and does not itself wait for (i, n): by edges and order, or since the module is
/// full. In one domain
///   release(j, m) + e < release(i, n) + a   and   release(j, m) + d > release(i, n) + d
/// In different domains, for any distance of the releases: d_j - e_j > d_i - a_i.
/// It can be blocked by (j, m) iff the same holds with last_start in place of e
/// (docs/keys.md, "Levels").
/// Drift needs nothing but that distances of one domain are taken with their error, at most ppm of
/// the longest one that matters.
/// Urgent releases (`u`; read if there are any) keep no phase to anything.
/// `only_xpu` -1: all.
void charge(const Problem& problem, const std::vector<int>& xpu, const Windows& w, const Windows& u,
            int only_xpu, Charges& out);

/// For how long an XNode keeps others waiting that it has to end for: whoever has started above others has
/// paid for it.
[[nodiscard]] Tick work_of_blocker(const Problem& problem, int xnode, int xpu);

/// The distance of two releases n periods apart may be shorter by so much, where the clock is fast.
[[nodiscard]] Tick lost_in(Tick distance, std::int64_t ppm);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Windows: from keys and holds to [a, d] of every job, and what windows cost on an XPU: who may
// start by preempting, and by whom a job on a non-preemptive XPU may be blocked.
//
//   a = max of  d_u + transfer     over predecessors u
//               J + offset - phase of the sources heard (roots)
//               hold
//               D - N T            (entries of a module; D: largest d in it, N activations before)
#pragma once

#include <vector>

#include "solver/steady/problem.h"

namespace xauto::solver::steady {

/// By slot, ticks after the nominal release.
struct Windows {
  std::vector<Tick> a, d;
  std::vector<Tick> hold;  ///< 0: none
};

/// Fills `a` of the domain from d and hold.
void derive_ready(const Problem& problem, int domain, const std::vector<int>& xpu, Windows& w);

/// [xnode] what it pays beyond its WCET.
struct Charges {
  std::vector<char> preempts;    ///< it may start by preempting: charged the XPU's cost
  std::vector<Tick> blocked_by;  ///< longest job that may run when it becomes ready, not preemptive
  /// Takes the larger of both. True if `other` had more of anything.
  bool include(const Charges& other);
};

/// i can preempt (be blocked by) j of its XPU iff for some pair of activations
///   (release of j) - (release of i) = Delta,  d_i - d_j < Delta < a_i,
/// since j may be ready as early as its release. Not for Delta = 0 where one precedes the other.
/// Different domains: any real Delta. Drift needs nothing: Delta of one domain is taken with its
/// error, at most ppm of the longest |Delta| that matters.
/// `only_xpu` -1: all.
void charge(const Problem& problem, const std::vector<int>& xpu, const Windows& w, int only_xpu,
            Charges& out);

}  // namespace xauto::solver::steady

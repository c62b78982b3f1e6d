// SPDX-License-Identifier: Apache-2.0
// The two answers that a developer would otherwise take.
#pragma once

#include "solver/problem.h"
#include "solver/until.h"

namespace xauto::solver {

/// Heterogeneous Earliest Finish Time, with insertion: XNodes by descending upward rank (mean WCET
/// plus the longest way to the end), each on the instance and into the gap where it finishes first.
/// Priorities: by planned start, earlier is more urgent.
/// Source: Topcuoglu, Hariri, Wu, "Performance-effective and low-complexity task scheduling for
/// heterogeneous computing", IEEE TPDS 13(3), 2002, sections 4.1 (equation 8, upward rank) and 4.2;
/// communication costs are zero here. O(n^2 m); what is left when `until` ends it goes behind all.
[[nodiscard]] Decision heft(const Problem& problem, const Until& until = {});

/// The local optimum: every XNode on its fastest type, whatever the others do; among instances of
/// that type the one where it finishes first. Priorities by planned start.
[[nodiscard]] Decision local(const Problem& problem, const Until& until = {});

}  // namespace xauto::solver

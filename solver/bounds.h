// SPDX-License-Identifier: Apache-2.0
// Lower bounds on the makespan that take microseconds to compute. All are valid for every schedule
// of problem.h's XNodes, preemptive, non-preemptive, with inserted idle time, on any assignment:
// they use only that an XNode needs its WCET on the type it runs on, after its predecessors, one
// XNode per XPU at a time. Sources and proofs: docs/solver.md.
#pragma once

#include <vector>

#include "solver/problem.h"
#include "solver/until.h"

namespace xauto::solver {

/// Least WCET over the types that the platform has an instance of.
[[nodiscard]] std::vector<Time> least_wcet(const Problem& problem);
/// Longest chain of least WCETs before / behind each XNode, itself excluded.
[[nodiscard]] std::vector<Time> static_heads(const Problem& problem);
[[nodiscard]] std::vector<Time> static_tails(const Problem& problem);

[[nodiscard]] Time critical_path_bound(const Problem& problem);
/// For every set S of types: the XNodes that can run only in S, each at its least WCET, over the
/// number of instances in S, plus the least head and tail among them.
[[nodiscard]] Time load_bound(const Problem& problem, const Until& until = {});
/// The same by instance, where the user has said who runs where: the XNodes that can run only on a
/// set of XPUs share these; a group is one block on one of its XPUs. 0 without pins and groups.
[[nodiscard]] Time placement_bound(const Problem& problem, const Until& until = {});
/// The fractional assignment that balances the types best, as its dual: for any Y_t >= 0
///   T >= h + q + sum over i in S(h, q) of min_t Y_t wcet_it / sum over t of Y_t instances(t)
/// where S(h, q) are the XNodes with head >= h and tail >= q. Y by coordinate search, then exact.
/// `prices`, if not null: the Y of the whole app, a hint for which type suits whom.
[[nodiscard]] Time balanced_load_bound(const Problem& problem,
                                       std::vector<std::int64_t>* prices = nullptr,
                                       const Until& until = {});
/// The largest of the four; what is left out when `until` ends it makes it weaker only.
[[nodiscard]] Time quick_bound(const Problem& problem, const Until& until = {});

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// The worst case: a bound on the end-to-end latency that holds when every job takes anything in
// [0, WCET], under the rule of problem.h, preemption costs and non-preemptive XPUs included.
//
// Fixed priorities alone have timing anomalies: a job that ends early may lengthen the whole. Two
// ways out, both here: run-time order pairs that remove the anomalies (the bound is then the
// longest path and equals the latency), and, for a policy without them, an analysis that is safe
// but looser.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "solver/search.h"

namespace xauto::solver {

inline constexpr std::int64_t kMostChainSteps = 2'000'000;

/// The order pairs of an ordered solution, transitively reduced: a pair that already follows from
/// the edges and the other pairs is left out.
[[nodiscard]] std::vector<std::pair<int, int>> order_pairs(const Problem& problem,
                                                           const Solution& solution,
                                                           const Until& until = {});

/// Priorities by deadline: the shorter of two safe bounds, where it applies.
///
/// Let C' be the WCET plus, for an XNode that may start by preempting, the cost of that (it starts
/// once). Let F be the finishes of the execution with C' and free preemption. If every XPU either
/// has all its XNodes ordered by edges and order pairs, or is preemptive and its priorities follow
/// F, then no execution of the real rule finishes any XNode after its F: docs/ilp.md, theorem, with
/// F as deadlines. An XPU with levels counts as preemptive where they suffice for whatever XNodes
/// may be open at once. nullopt where neither holds for an XPU.
[[nodiscard]] std::optional<Time> deadline_certificate(const Problem& problem,
                                                       const Decision& decision,
                                                       const Until& until = {});

/// The decision with priorities put in the order of their own F, so that the certificate applies,
/// where that keeps the latency; otherwise as given. Order pairs stay.
[[nodiscard]] Decision settle_priorities(const Problem& problem, const Decision& decision,
                                         const Until& until = {});

/// The decision with the order of its own schedule on every XPU on which that suspends nobody: at
/// WCET nothing changes, and the certificate needs nothing else of those XPUs.
[[nodiscard]] Decision order_undisturbed(const Problem& problem, const Decision& decision);

/// A safe bound for any decision, with or without order pairs: the least of deadline_certificate()
/// and of what follows.
///
/// Take the XNode i that finishes last, then the predecessor (by edge or order pair) that made it
/// eligible last, and so on to a source: a chain whose response intervals [eligible, finish] follow
/// each other without a gap. Within i's interval its XPU is never idle and runs only i, XNodes of
/// higher priority that are not ordered against i by the graph, and, on an XPU that does not preempt
/// or has as many XNodes open as levels, at most one of lower priority that had started before. An
/// XNode runs once, so along one chain each interferes once:
///
///   latency <= max over chains of  sum over i in chain of (C_i + S_i + B_i)
///                                  + sum over j in the union of hp(i), i in chain, of (C_j + S_j)
///
/// S: preempt_us where a start can preempt; B: longest lower-priority C on a non-preemptive XPU. With
/// L levels, B: longest lower-priority C + S among those j that may be the L-th. j is at most the
/// l-th if no longer sequence of rising priorities ends with it, each XNode unordered with the next:
/// those that have started and not ended are such a sequence, the running one its last.
/// Chains are enumerated with a bound; past `max_steps` or `until`, each chain's interference is
/// counted per XNode instead (classical response times), which is larger and still safe.
///
/// Never more than all XNodes one after the other, each paying for a preemption: some XPU is busy
/// until the last one has ended. That alone is left of the chains above a few thousand XNodes.
[[nodiscard]] Time worst_case(const Problem& problem, const Decision& decision,
                              std::int64_t max_steps = kMostChainSteps, const Until& until = {});

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// Large neighbourhood search over ordered schedules (ordered.h), for large apps: one stretch of the
// schedule, some tens of XNodes that start one after the other, is annealed while all before and
// behind it stays.
//
// What stays gives each XNode of the stretch a release and a tail, each XPU an instant from which
// it is free and a time that it needs behind its last one. With these the longest path through the
// stretch is known exactly, and those beside it do not change (docs/solver.md, "Stretches"). So a
// candidate costs some tens of XNodes in place of all, and each stretch cools down like a small app.
// Proof. The makespan is the longest path of the graph of edges and neighbours on an XPU. The
// XNodes before the stretch have no predecessor and no neighbour before them in it, or behind it:
// the sequence is a linear extension, and a stretch is consecutive in it. So r_i and f_x are the
// same whatever is done in the stretch; likewise q_i and g_x, from behind. A path that meets the
// stretch goes in by an r_i or f_x, stays, and goes out by a q_i or g_x. What stays is followed by
// the evaluator (ordered.h).
//
// Only for the makespan alone, without groups. Threads: one owner. Deterministic like anneal().
// Units: microseconds.
#pragma once

#include <cstddef>
#include <vector>

#include "solver/disjunctive.h"
#include "solver/ordered.h"
#include "solver/problem.h"
#include "solver/search.h"

namespace xauto::solver {

/// `graph` becomes that of `schedule`, which gets its makespan and its sequence by start.
void follow(DisjunctiveGraph& graph, Solution& schedule);

/// Some XNodes of a schedule as a problem of their own.
struct Stretch {
  std::vector<int> members;  ///< [xnode of the part] -> xnode of the whole
  Problem part;
  Surroundings around;
  Solution now;  ///< what the schedule does with them
  Time outside =
      0;  ///< the whole's makespan is the part's and this, if no path beside it is longer
};

/// Those at the places `first` to `first + length - 1` of `schedule`, as follow() has left both.
[[nodiscard]] Stretch stretch_of(const Problem& problem, const DisjunctiveGraph& graph,
                                 const Solution& schedule, std::size_t first, std::size_t length);

[[nodiscard]] bool stretches_serve(const Problem& problem);

/// Goes on from `start`, which is ordered, until the limits; the best, `start` included.
[[nodiscard]] Solution anneal_stretches(const Problem& problem, const Solution& start,
                                        std::uint64_t seed, const StopWhen& stop_when,
                                        const SearchCallbacks& callbacks = {});

}  // namespace xauto::solver

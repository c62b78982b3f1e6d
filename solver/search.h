// SPDX-License-Identifier: Apache-2.0
// Anytime search: constructive starts, then simulated annealing with critical-chain moves, over
// (assignment, priority), over (assignment, order per XPU), and over both together. Deterministic
// for a given seed when it is ended by `max_evaluations`.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <vector>

#include "solver/evaluate.h"
#include "solver/problem.h"
#include "solver/until.h"

namespace xauto::solver {

struct Surroundings;  // ordered.h

/// When to end. `target`: an answer this good cannot be beaten (a lower bound, may rise meanwhile).
struct StopWhen {
  TimePoint deadline = TimePoint::max();
  std::int64_t max_evaluations = 0;  ///< 0: no limit
  const std::atomic<bool>* stop = nullptr;
  const std::atomic<bool>* stop_too = nullptr;  ///< a second source of stop, e.g. "proven optimal"
  const std::atomic<Time>* target = nullptr;
  int effort =
      0;  ///< lengthens the first cooling: 0 for a first search, more to go on from its answer

  [[nodiscard]] bool stopped() const {
    return (stop != nullptr && stop->load(std::memory_order_relaxed)) ||
           (stop_too != nullptr && stop_too->load(std::memory_order_relaxed)) ||
           (deadline != TimePoint::max() && std::chrono::steady_clock::now() >= deadline);
  }
};

struct Solution {
  std::vector<int> xpu;
  std::vector<int> sequence;  ///< XNodes, most urgent first
  Time makespan = kNever;     ///< or the cost, where Problem::goal asks for something else
  bool ordered = false;  ///< every XPU keeps to the sequence (PriorityPlan::order), no preemption
  std::vector<int> waits_for;  ///< whom each XNode waits for on its XPU (evaluate.h); empty: nobody
};

/// Above this many XNodes, the search changes: more starts, raced against each other, and colder
/// annealing (docs/solver.md, "Large apps").
inline constexpr int kLarge = 60;

/// List scheduling by earliest finish, one answer per ranking rule (longest tail by least, mean and
/// greatest WCET, with and without the load of the fastest XPU type in view); best first.
/// At least one, and all of them unless `until` ends it.
[[nodiscard]] std::vector<Solution> constructive_solutions(const Problem& problem,
                                                           const Until& until = {});

/// `sequence` that repeats a Decision's priorities.
[[nodiscard]] std::vector<int> sequence_of(const std::vector<std::int64_t>& priority);
/// Puts every group (Problem::groups) on one instance, the one most of it is on.
void gather_groups(const Problem& problem, std::vector<int>& xpu);
[[nodiscard]] Decision to_decision(const Solution& solution);

struct SearchCallbacks {
  std::function<void(const Solution&)> on_better;    ///< each improvement of this search's best
  std::function<void(std::int64_t)> on_evaluations;  ///< since the last call, every few thousand
};

/// Anneals from `start` until the limits; returns the best seen, `start` included.
[[nodiscard]] Solution anneal(const Problem& problem, const Solution& start, std::uint64_t seed,
                              const StopWhen& stop_when, const SearchCallbacks& callbacks = {});
/// The same over ordered schedules (ordered.h); `start` may be any solution. `around`: of a part.
[[nodiscard]] Solution anneal_ordered(const Problem& problem, const Solution& start,
                                      std::uint64_t seed, const StopWhen& stop_when,
                                      const SearchCallbacks& callbacks = {},
                                      const Surroundings* around = nullptr);
/// The same over all policies: priorities, and each XNode may wait for another one of its XPU.
[[nodiscard]] Solution anneal_mixed(const Problem& problem, const Solution& start,
                                    std::uint64_t seed, const StopWhen& stop_when,
                                    const SearchCallbacks& callbacks = {});
/// An ordered solution as one in which each XNode waits for the one before it on its XPU.
[[nodiscard]] Solution as_waiting(const Solution& ordered);
/// Priorities alone, by the finishes of `solution`: where preemption is free it takes no
/// longer (docs/ilp.md, theorem), elsewhere it may or may not.
[[nodiscard]] Solution by_finish(const Problem& problem, const Solution& solution);

}  // namespace xauto::solver

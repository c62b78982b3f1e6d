// SPDX-License-Identifier: Apache-2.0
// Bounds by proof: destructive improvement with branching on the assignment. docs/solver.md has the
// argument in full.
//
// For a guessed makespan T the question is whether some assignment survives all necessary
// conditions: windows [r, d] from the precedence graph and the WCETs left, energy in windows per
// type, the LP over the fractional assignment, and the rules about pairs and suspensions of
// rules.h. If every branch is refuted, no policy is shorter than T + 1, whatever its priorities and
// its run-time order pairs.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>

#include "solver/search.h"

namespace xauto::solver {

/// XNodes; beyond, one LP of the proof takes too long.
inline constexpr int kMostToProve = 400;
/// Where evaluations are limited, a proof has an LP for so many of them. Chosen.
inline constexpr std::int64_t kEvaluationsPerLp = 50;

struct ProofControl {
  TimePoint deadline = TimePoint::max();
  std::int64_t max_lps = 0;  ///< 0: no limit; with a limit the bound does not depend on speed
  const std::atomic<bool>* stop = nullptr;
  const std::atomic<bool>* stop_too = nullptr;
  const std::atomic<Time>* incumbent =
      nullptr;                         ///< falls meanwhile; the proof need not go beyond it
  Time known_bound = 0;                ///< from elsewhere; the proof starts there
  std::function<void(Time)> on_bound;  ///< each improvement
  std::function<void(const Solution&)> on_solution;

  [[nodiscard]] bool stopped() const {
    return (stop != nullptr && stop->load(std::memory_order_relaxed)) ||
           (stop_too != nullptr && stop_too->load(std::memory_order_relaxed)) ||
           (deadline != TimePoint::max() && std::chrono::steady_clock::now() >= deadline);
  }
};

/// The best bound proven until `control` ends it, or until every tree below the incumbent was
/// searched to its end and kept a leaf that no condition refutes: more time then proves nothing
/// more, a better incumbent might.
[[nodiscard]] Time prove_bound(const Problem& problem, const ProofControl& control);

}  // namespace xauto::solver

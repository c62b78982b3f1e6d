// SPDX-License-Identifier: Apache-2.0
// Load bound: the least worst case of a chain, or of several together, over all assignments that
// overload no type of XPU.
//
// A way has pieces; of each its longest path counts. A term is the longest of its ways, each with
// what it waits; several terms are summed, or the largest counts. In both cases a mean over picks of
// paths is at most the objective. With n_i how often the picks visit XNode i (times the weights of
// the terms), K picks, and prices y >= 0 of the types
//   objective >= mean of the waits + sum over i of min over t of (n_i / K + y_t / T_i) C_it
//                - sum over t of y_t |t|
// since what runs on a type is at most |t| of its time. Paths and prices are found by ascent in
// floating point; the sum is then taken in integers, rounded down. Where a bound depends on who is
// split between types, one XNode after the other is fixed: the least of all cases holds.
//
// Cases part further by who has the longer windows on an XPU where clocks meet (meetings.h): in each
// of them XNodes take more than their work. Choices that are still open add the least of their options,
// those that have no XNode in common. A pick that meets its own earlier activations is longer by that.
// docs/keys.md, theorems 5, 9 and 11, has the proofs.
#pragma once

#include <cstdint>
#include <vector>

#include "solver/keys/problem.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// A piece of a way: from any of `from` along edges to `to`.
struct Piece {
  std::vector<int> from;
  int to = -1;
};

struct LoadWay {
  std::vector<Piece> pieces;
  Tick ready = 0;  ///< its first XNode cannot begin before
  Tick waits = 0;  ///< what the way takes apart from that and its XNodes, at least; may be negative
};

/// A chain of an objective.
struct Term {
  std::vector<LoadWay> ways;
  Tick known = 0;           ///< a bound of its own
  std::int64_t weight = 1;  ///< of a sum
  Tick by = 1;              ///< by which its worst case is divided
};

/// Weights of terms in whole units of 2^-kShift / longest, rounded down: no part is less than it says.
struct Weights {
  static constexpr int kShift = 20;
  std::vector<std::int64_t> of;  ///< [term]
  Tick longest = 1;              ///< of what terms are divided by

  Weights(const std::vector<Term>& terms, bool sum);
  /// Of an objective in these units, not negative; rounded down.
  [[nodiscard]] double value(__int128 units) const;
};

/// Of one chain, in ticks. `most_cases`: how many cases are parted at most.
[[nodiscard]] Tick load_bound(const Problem& problem, const std::vector<LoadWay>& ways,
                              int most_cases, const Until& until = {});
/// Of the weighted sum of worst case / by, rounded down. 0: nothing follows.
[[nodiscard]] double sum_bound(const Problem& problem, const std::vector<Term>& terms,
                               int most_cases, const Until& until = {});
/// Of the largest worst case / by, rounded down. 0: nothing follows.
[[nodiscard]] double largest_bound(const Problem& problem, const std::vector<Term>& terms,
                                   int most_cases, const Until& until = {});

}  // namespace xauto::solver::keys

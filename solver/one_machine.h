// SPDX-License-Identifier: Apache-2.0
// What one instance of a type allows the XNodes that are decided for it: a part of the proof
// (exact.h), between the windows of the precedence graph and the LP.
//
// Work w_i that has to be done in [r_i, d_i] on one preemptive instance can be done iff for all
// a < b the work of those with a <= r_i and d_i <= b is at most b - a (Horn 1974). So let W(a, b) be
// that work. If c is not among them, and could not end by b,
//     a + W(a, b) + w_c > b  for some a <= r_c,  then c ends at a + W(a, b) + w_c or later,
// and whoever waits for c starts no earlier. The same backwards. docs/solver.md, "Proof", has the
// argument; Carlier and Pinson (1990) have it for jobs that are not suspended.
#pragma once

#include <vector>

#include "solver/energy_lp.h"
#include "solver/problem.h"

namespace xauto::solver {

class OneMachine {
 public:
  explicit OneMachine(const Problem& problem) : problem_(problem) {}

  enum class Answer { kSame, kNarrowed, kImpossible };

  /// Narrows the windows of predecessors and successors of those whose instance is known: all of a
  /// type that has one instance, and those with a place. Takes such a type from an XNode that would
  /// not fit beside those that are decided for it.
  [[nodiscard]] Answer narrow(Windows& windows);

 private:
  struct Item {
    int xnode;
    Time r, d, work;  ///< as they were before anything was narrowed
  };

  /// Fills the table; false: those of the instance do not fit.
  [[nodiscard]] bool load(const Windows& windows, int type, int place);
  [[nodiscard]] Time work(const Windows& windows, int xnode, int type) const;
  /// No schedule ends / starts `c` earlier / later.
  [[nodiscard]] Time earliest_end(const Item& c) const;
  [[nodiscard]] Time latest_start(const Item& c) const;
  [[nodiscard]] bool fits_beside(const Item& c) const;
  /// The first by r with r >= `time`, the first by d with d >= `time`.
  [[nodiscard]] std::size_t first_by_r(Time time) const;
  [[nodiscard]] std::size_t first_by_d(Time time) const;

  const Problem& problem_;
  std::vector<Item> by_r_, by_d_;
  // [a * items + b]: W from the r of the a-th by r to the d of the b-th by d;
  std::vector<Time> inside_;
  std::vector<Time>
      done_;  ///< the largest r + W to that d, of the a-th and those before it; 0: none
  std::vector<Time> due_;  ///< the least d - W from that r, of the b-th and those behind it; kNever
};

}  // namespace xauto::solver

// SPDX-License-Identifier: Apache-2.0
// Meetings: what follows for windows where XNodes share an XPU, whatever the keys and holds.
//
// XNodes of different clocks meet at every phase (theorem 9), and a component that is alone with its
// period meets its own earlier activations (theorem 11). docs/keys.md has the proofs.
#pragma once

#include <array>
#include <vector>

#include "solver/keys/problem.h"

namespace xauto::solver::keys {

/// All windows of an XNode are longer than its WCET, by so much.
struct Longer {
  int xnode = -1;  ///< -1: nothing
  Tick by = 0;
};

/// In any policy one of the options holds, with all that it says.
struct Disjunction {
  std::array<std::array<Longer, 2>, 3> options;
  std::size_t count = 0;

  void add(Longer one, Longer other = {}) { options[count++] = {one, other}; }
};

/// Of XNodes that all run on `xpu`. Threes are looked at among the first `most_in_threes` only.
[[nodiscard]] std::vector<Disjunction> choices_on(const Problem& problem, int xpu,
                                                  const std::vector<int>& on,
                                                  std::size_t most_in_threes);

/// Whether an XNode's windows repeat with its period.
[[nodiscard]] inline bool repeats_at_once(const Problem& problem, int xnode) {
  return problem.jobs[at(xnode)] == 1;
}

/// A stretch of a way, from an XNode to a later one of the same XPU, is known to take `length`, of
/// that `longer` more than WCETs in these two. By how much more it takes, since activations meet.
/// `first`, `last`: their WCETs.
[[nodiscard]] Tick meets_itself(Tick period, Tick first, Tick last, Tick length, Tick longer);

}  // namespace xauto::solver::keys

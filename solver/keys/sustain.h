// SPDX-License-Identifier: Apache-2.0
// Sustain: proofs that no policy keeps up, over all assignments, before anything is searched.
//
// A place is XPUs of one type that pins and forbids leave alike; a unit an XNode, or a group.
// Load. For all weights w >= 0 of places, not all 0, and work C over period T:
//   lambda = sum over units of min over t of sum over i of  w_t C_it / (T_i |t|)   /   sum over t of w_t
// No assignment loads all places by less than lambda: multiply each place's load by its weight, and
// give each unit its cheapest place. lambda > 1 therefore proves that some XPU gets more work than
// time. It is the dual of the LP that spreads XNodes fractionally; the weights are the certificate,
// one line, checked in integers. lambda <= 1 proves nothing.
//
// Span. An entry of a module with N in flight starts N activations later no earlier than its
// activation has left; the longest way of least WCETs from it to an XNode of the module is then at
// most N T. And one XNode takes its activations one by one: least WCET <= T.
//
// Both: places have prices w, ways through modules prices z >= 0. If
//   sum over i of min over t of (w_t / (T_i |t|) + z_M / (N_M T_M)) C_it  >  sum of all prices
// then each assignment breaks a load or a span; z counts for i on the way of its module M.
//
// Whole units: unpackable.h.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "solver/keys/problem.h"

namespace xauto::solver::keys {

struct OverloadProof {
  std::string text;  ///< "gpu at least 112 %"
  /// What is asked of what is there, rounded down; nullopt: of whole units, which have no such number.
  std::optional<std::int64_t> load_pct = {};
  std::vector<std::pair<std::string, std::int64_t>> weights = {};  ///< of places, by name
  /// An XNode of the module, its price: where load and spans prove it together.
  std::vector<std::pair<int, std::int64_t>> module_weights = {};
  std::vector<std::pair<int, std::int64_t>> causes =
      {};  ///< XNode, its share in tenths of a percent
};

/// The proof, if one of these is one. Pins and forbids count.
[[nodiscard]] std::optional<OverloadProof> prove_overload(const Problem& problem);
/// The best weights found, sum kWeights: prices of the places, for constructing.
[[nodiscard]] std::vector<std::int64_t> balancing_weights(const Problem& problem);
inline constexpr std::int64_t kWeights = 1 << 16;

/// floor(lambda * 10^6) of these weights, in integers; at most 10^15.
[[nodiscard]] std::int64_t load_ppm(const Problem& problem,
                                    const std::vector<std::int64_t>& weights);

/// What stays together: each group, and each other XNode.
[[nodiscard]] std::vector<std::vector<int>> units(const Problem& problem);
/// Longest way of these WCETs from XNode `from` to an XNode of `module`.
[[nodiscard]] Tick span(const Problem& problem, const std::vector<Tick>& takes,
                        const Module& module, int from);
/// Names those with the largest shares in the proof.
void keep_causes(std::vector<std::pair<int, double>> shares, OverloadProof& proof);

}  // namespace xauto::solver::keys

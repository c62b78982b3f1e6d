// SPDX-License-Identifier: Apache-2.0
// Proofs that no policy keeps up since XNodes are whole: three of 60 % do not fit on two CPUs.
//
// Every unit (an XNode, or a group) goes to an XPU. Its load there is the sum of C / T, in parts of
// 2^-40 and rounded down. An assignment is refuted where it loads an XPU above 1, or keeps an
// activation in its module for too long (sustain.h). All of them are tried, the unit first that
// fewest XPUs take; XPUs of one place that are equally full are one case. Nothing is proven where that
// takes too long.
//
// With f of packing.h the sum of f(load) on an XPU is at most f's room. So a search by f(load) refutes,
// too, and what differs by little is then the same: it takes fewer steps.
#pragma once

#include "solver/keys/sustain.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// Looks of a unit at an XPU: before the search, and where that found nothing.
inline constexpr std::int64_t kFirstLooks = 1'000'000, kLastLooks = 100'000'000;

[[nodiscard]] std::optional<OverloadProof> prove_unpackable(const Problem& problem,
                                                            std::int64_t looks,
                                                            const Until& until = {});

/// Whether every assignment with `xnode` on `xpu` and none of `apart` there is refuted.
[[nodiscard]] bool cannot_place(const Problem& problem, int xnode, int xpu,
                                const std::vector<int>& apart, std::int64_t looks);

}  // namespace xauto::solver::keys

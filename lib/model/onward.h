// SPDX-License-Identifier: Apache-2.0
// Through which samples a release is followed, so that what comes round in a circle is not taken for
// something old. Pure.
#pragma once

#include <utility>
#include <vector>

namespace xauto {

inline constexpr int kUnreached = -1;

/// [component] a rank: what stems from a source goes on through the samples that lead to a higher
/// one. kUnreached: nothing of it comes there. `hears`: [component] whether it hears of the source
/// itself; `samples`: (component that is read, component that reads).
///
/// A chain is the worst of its ways, no component twice. Where samples make no circle, each sample
/// leads to a higher rank, so all ways count. In a circle (a strongly connected part) they lead away
/// from the components by which the release comes in, so each is visited once; of the ways from
/// there, those that take more samples than needed are left out. O(components + samples).
[[nodiscard]] std::vector<int> ranks_of(const std::vector<char>& hears,
                                        const std::vector<std::pair<int, int>>& samples);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Slices that overlap go to lanes of their own: one track may only nest.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace xauto::story {

/// Sorts pieces by begin and gives each a lane; returns how many lanes there are. T: begin, end,
/// lane.
template <class T>
int assign_lanes(std::vector<T*>& pieces) {
  std::stable_sort(pieces.begin(), pieces.end(),
                   [](const T* a, const T* b) { return a->begin < b->begin; });
  std::vector<std::int64_t> busy_until;
  for (T* piece : pieces) {
    auto lane = std::find_if(busy_until.begin(), busy_until.end(),
                             [&](std::int64_t until) { return until <= piece->begin; });
    if (lane == busy_until.end()) lane = busy_until.insert(lane, 0);
    *lane = std::max(piece->begin, piece->end);
    piece->lane = static_cast<int>(lane - busy_until.begin());
  }
  return static_cast<int>(busy_until.size());
}

}  // namespace xauto::story

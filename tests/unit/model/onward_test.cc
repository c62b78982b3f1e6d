// SPDX-License-Identifier: Apache-2.0
// ranks_of against what a way is: edges, no component twice. The ways are followed one by one here.
#include "model/onward.h"

#include <random>
#include <set>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"

namespace xauto {
namespace {

using Edges = std::vector<std::pair<int, int>>;

struct Drawn {
  std::vector<char> hears;
  Edges samples;
};

Drawn drawn(std::mt19937& random, bool circles) {
  const int n = 2 + static_cast<int>(random() % 6);
  Drawn d;
  d.hears.assign(at(n), 0);
  d.hears[random() % at(n)] = 1;
  if (random() % 3 == 0) d.hears[random() % at(n)] = 1;
  for (int u = 0; u < n; ++u)
    for (int v = 0; v < n; ++v)
      if ((circles || u < v) && random() % 3 == 0) d.samples.emplace_back(u, v);
  return d;
}

/// Edges that some way takes which begins where the release comes in.
void follow(const Drawn& d, int c, std::vector<char>& visited,
            std::set<std::pair<int, int>>& taken) {
  visited[at(c)] = 1;
  for (const auto& [u, v] : d.samples)
    if (u == c && visited[at(v)] == 0) {
      taken.emplace(u, v);
      follow(d, v, visited, taken);
    }
  visited[at(c)] = 0;
}
std::set<std::pair<int, int>> on_a_way(const Drawn& d) {
  std::set<std::pair<int, int>> taken;
  std::vector<char> visited(d.hears.size(), 0);
  for (std::size_t c = 0; c < d.hears.size(); ++c)
    if (d.hears[c] != 0) follow(d, static_cast<int>(c), visited, taken);
  return taken;
}
std::set<std::pair<int, int>> onward(const Drawn& d) {
  const std::vector<int> rank = ranks_of(d.hears, d.samples);
  std::set<std::pair<int, int>> carried;
  for (const auto& [u, v] : d.samples)
    if (rank[at(u)] != kUnreached && rank[at(u)] < rank[at(v)]) carried.emplace(u, v);
  return carried;
}

TEST(Onward, WithoutCirclesEveryWayCounts) {
  std::mt19937 random(1);
  for (int n = 0; n < 2000; ++n) {
    const Drawn d = drawn(random, false);
    ASSERT_EQ(onward(d), on_a_way(d)) << "graph " << n;
  }
}

TEST(Onward, InCirclesNothingComesRoundAndNobodyIsLeftOut) {
  std::mt19937 random(2);
  int fewer = 0;
  for (int n = 0; n < 2000; ++n) {
    const Drawn d = drawn(random, true);
    const auto ways = on_a_way(d), carried = onward(d);
    // Ranks rise along them, so they make no circle. Those between parts that no circle joins are all there.
    std::vector<std::vector<char>> reach(d.hears.size(), std::vector<char>(d.hears.size(), 0));
    for (const auto& [u, v] : d.samples) reach[at(u)][at(v)] = 1;
    for (std::size_t k = 0; k < reach.size(); ++k)
      for (std::size_t i = 0; i < reach.size(); ++i)
        for (std::size_t j = 0; j < reach.size(); ++j)
          if (reach[i][k] != 0 && reach[k][j] != 0) reach[i][j] = 1;
    std::set<int> told, reached;
    for (std::size_t c = 0; c < d.hears.size(); ++c)
      if (d.hears[c] != 0) told.insert(static_cast<int>(c)), reached.insert(static_cast<int>(c));
    for (const auto& edge : carried) {
      ASSERT_TRUE(ways.count(edge) != 0) << "graph " << n;
      told.insert(edge.second);
    }
    for (const auto& [u, v] : ways) {
      reached.insert(v);
      ASSERT_TRUE(reach[at(v)][at(u)] != 0 || carried.count({u, v}) != 0)
          << "graph " << n << ": " << u << " to " << v;
    }
    ASSERT_EQ(told, reached) << "graph " << n;
    if (carried != ways) ++fewer;
  }
  EXPECT_GT(fewer, 0) << "no graph had a circle";
}

}  // namespace
}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
#include "model/onward.h"

#include <deque>

#include "base/index.h"

namespace xauto {
namespace {

using Lists = std::vector<std::vector<int>>;

/// Components, those from which nothing is left to visit first. Iterative: they may be thousands.
std::vector<int> by_end(const Lists& next) {
  std::vector<int> order;
  std::vector<char> seen(next.size(), 0);
  std::vector<std::pair<int, std::size_t>> path;  // (component, how many of its samples are done)
  for (std::size_t from = 0; from < next.size(); ++from) {
    if (seen[from] != 0) continue;
    seen[from] = 1;
    path.emplace_back(static_cast<int>(from), 0);
    while (!path.empty()) {
      auto& [c, done] = path.back();
      if (done == next[at(c)].size()) {
        order.push_back(c);
        path.pop_back();
        continue;
      }
      const int to = next[at(c)][done++];
      if (seen[at(to)] != 0) continue;
      seen[at(to)] = 1;
      path.emplace_back(to, 0);
    }
  }
  return order;
}

}  // namespace

std::vector<int> ranks_of(const std::vector<char>& hears,
                          const std::vector<std::pair<int, int>>& samples) {
  const std::size_t count = hears.size();
  Lists next(count), previous(count);
  for (const auto& [u, v] : samples) {
    next[at(u)].push_back(v);
    previous[at(v)].push_back(u);
  }
  // Strongly connected parts, by Kosaraju's algorithm: those that are read come before their readers.
  const std::vector<int> order = by_end(next);
  std::vector<int> part(count, -1), rank(count, kUnreached);
  int base = 0, parts = 0;
  for (auto root = order.rbegin(); root != order.rend(); ++root) {
    if (part[at(*root)] >= 0) continue;
    std::vector<int> members = {*root};
    part[at(*root)] = parts;
    for (std::size_t i = 0; i < members.size(); ++i)
      for (const int u : previous[at(members[i])])
        if (part[at(u)] < 0) part[at(u)] = parts, members.push_back(u);
    std::deque<int> away;  // breadth first, from where the release comes in
    for (const int c : members) {
      bool enters = hears[at(c)] != 0;
      for (const int u : previous[at(c)])
        enters = enters || (part[at(u)] != parts && rank[at(u)] != kUnreached);
      if (!enters) continue;
      rank[at(c)] = base;
      away.push_back(c);
    }
    int highest = base;
    for (; !away.empty(); away.pop_front())
      for (const int v : next[at(away.front())]) {
        if (part[at(v)] != parts || rank[at(v)] != kUnreached) continue;
        highest = rank[at(v)] = rank[at(away.front())] + 1;
        away.push_back(v);
      }
    base = highest + 1;
    ++parts;
  }
  return rank;
}

}  // namespace xauto

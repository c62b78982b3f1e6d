// SPDX-License-Identifier: Apache-2.0
// The graphs of the dispatch rows, and what a node does: nearly nothing.
#pragma once

#include <algorithm>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

namespace xauto::bench {

struct Dag {
  std::string name;
  int nodes = 0;
  std::vector<std::vector<int>> after;  ///< [node] -> successors
  std::vector<int> before;              ///< [node] -> number of predecessors
};

inline Dag chain(int nodes) {
  Dag dag{"chain" + std::to_string(nodes), nodes, {}, {}};
  dag.after.resize(static_cast<std::size_t>(nodes));
  dag.before.assign(static_cast<std::size_t>(nodes), 1);
  dag.before[0] = 0;
  for (int i = 1; i < nodes; ++i) dag.after[static_cast<std::size_t>(i) - 1].push_back(i);
  return dag;
}

/// 40 nodes, 83 edges: node 0 is the only source, node 39 the only sink.
inline Dag dag40() {
  Dag dag{"dag40", 40, {}, {}};
  dag.after.resize(40);
  dag.before.assign(40, 0);
  std::mt19937 random(7);
  int edges = 0;
  const auto add = [&](int u, int v) {
    auto& after = dag.after[static_cast<std::size_t>(u)];
    if (u >= v || std::find(after.begin(), after.end(), v) != after.end()) return;
    after.push_back(v);
    ++dag.before[static_cast<std::size_t>(v)];
    ++edges;
  };
  for (int v = 1; v < 40; ++v) add(static_cast<int>(random() % static_cast<unsigned>(v)), v);
  for (int u = 0; u < 39; ++u)
    if (dag.after[static_cast<std::size_t>(u)].empty()) add(u, 39);
  while (edges < 83) {
    const int u = static_cast<int>(random() % 39);
    add(u, u + 1 + static_cast<int>(random() % static_cast<unsigned>(39 - u)));
  }
  return dag;
}

inline volatile std::uint64_t g_work;
inline void node_body() {
  g_work = g_work + 1;
}

}  // namespace xauto::bench

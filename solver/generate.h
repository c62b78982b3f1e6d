// SPDX-License-Identifier: Apache-2.0
// The paper's synthetic workload. What its text leaves open is an option here, and every value is
// printed with the result; docs/synthetic.md says why each default is what it is.
// The same seed and options give the same app on every machine.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "model/app.h"

namespace xauto::solver {

struct GenerateOptions {
  int nodes = 20;  ///< exactly this many XNodes, by rejection
  std::uint64_t seed = 1;

  // Shape: recursive series-parallel expansion, starting from one node.
  double terminal = 0.4;  ///< probability that a node stays one XNode (the first never does)
  int max_depth = 0;      ///< nesting of parallel sub-graphs; 0: 4, more where `nodes` needs it
  int branch_min = 2, branch_max = 6;  ///< branches of a parallel sub-graph, uniform
  /// The fork and the join of a sub-graph are XNodes themselves; otherwise the branches hang
  /// directly on what comes before and after.
  bool fork_join = true;
  double sibling_edge = 0.1;  ///< probability of an edge, per pair of branches of one sub-graph
  /// "forward": from the earlier branch's exits to the later one's entries; "shuffled": the
  /// branches are put in random order first; "node": from a random XNode of the one to a random
  /// XNode of the other.
  std::string sibling_direction = "forward";

  // Times, drawn uniformly.
  std::int64_t cpu_min_us = 5'000, cpu_max_us = 95'000;
  double heavy_share = 0.6;                 ///< the XNodes with the largest CPU time
  double heavy_gpu = 1.0, heavy_dla = 0.8;  ///< probability of an implementation
  double light_gpu = 0.5, light_dla = 0.3;
  double gpu_speedup_min = 3, gpu_speedup_max = 8;
  double dla_speedup_min = 2, dla_speedup_max = 5;
  /// Probability that an XNode with another implementation has one for the CPU too.
  double cpu_share = 1.0;

  /// Every option with its value, for the record of a result.
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> describe() const;
};

/// kInvalid: an option out of range; kInfeasible: rejection found no graph of this size.
[[nodiscard]] Result<AppSpec> generate(const GenerateOptions& options);

}  // namespace xauto::solver

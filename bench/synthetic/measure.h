// SPDX-License-Identifier: Apache-2.0
// One DAG of the synthetic workload on one platform: everything that the paper's sections 6.1
// and 6.2 plot.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"

namespace xauto::bench {

struct Settings {
  double time_limit_s = 1;
  int threads = 1;
  int max_depth = 4;
  bool fork_join = true;  ///< of the workload: fork and join count as XNodes
};

/// Microseconds unless the name says otherwise.
struct Measured {
  std::string platform;
  int nodes = 0;
  std::uint64_t seed = 0;
  std::int64_t ros2_ideal = 0;   ///< fastest type each, zero-cost processor sharing
  std::int64_t ros2_slices = 0;  ///< the same with the platform's time slice and switch cost
  std::int64_t heft = 0;
  std::int64_t xauto = 0;
  std::int64_t emulated = 0;   ///< XAuto's policy on the emulated XPUs; 0: not measured
  std::int64_t bound = 0;      ///< proven
  std::int64_t certified = 0;  ///< the least found that is ordered on every XPU
  std::int64_t unscheduled_ideal = 0, unscheduled_slices = 0;  ///< XAuto's assignment, time sharing
  std::int64_t unassigned = 0;  ///< fastest type each, instances and priorities searched
  std::int64_t first = 0;       ///< the first answer's latency
  double first_ms = 0;          ///< from the JSON texts to the first answer shown as progress
  double solve_s = 0;
  double evaluations_per_s = 0;
  bool optimal = false;

  [[nodiscard]] double gap() const {
    return static_cast<double>(xauto - bound) / static_cast<double>(xauto);
  }
};

/// The workload's DAG `seed` of a group of `nodes`. On a platform with an NPU and no DLA, what runs
/// on a DLA runs on the NPU.
[[nodiscard]] Result<AppSpec> workload(int nodes, std::uint64_t seed, const Settings& settings,
                                       const Platform& platform);
[[nodiscard]] Result<Measured> measure(const AppSpec& app, const Platform& platform,
                                       const Settings& settings);

}  // namespace xauto::bench

// SPDX-License-Identifier: Apache-2.0
// Chains, end to end: from a sensor's topic to a module that reads it directly or through others.
//
//   origin k ──────────► publish k                       latency of k, counted against deadline_us
//   origin k ──────────────────────────► publish k+1     age of k when it is replaced, the oldest
//                                                        that the chain's result ever gets;
//                                                        counted against max_age_us
//
// "Publish" is the end of the module's chain of XNodes. With sensors of several periods a result
// has one origin per sensor (Envelope::origins), so every chain has latencies of its own.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "graph/graph.h"
#include "model/deployment.h"
#include "session/run_report.h"

namespace xauto::runtime {

class Board;
struct FlowLine;

/// Threads: any.
class Routes {
 public:
  /// The deployment's chains; without any, every sensor to every sink, with the app's deadline.
  /// Errors: a chain from a topic that is no sensor's, or to a module that cannot hear of it.
  [[nodiscard]] static Result<Routes> make(const Graph& graph, const Deployment& deployment,
                                           std::optional<std::int64_t> deadline_us);

  [[nodiscard]] std::size_t size() const { return routes_.size(); }
  /// Counts on the board from here on, too: chain i is flow i + 1.
  void show_on(Board& board);
  /// Whether a chain ends at `module`.
  [[nodiscard]] bool end_at(int module) const {
    return !ends_[static_cast<std::size_t>(module)].empty();
  }
  /// `module` has published what stems from `origin_ns`, or by source from `origins`. Returns the
  /// latency of a chain that so missed its deadline, or the age of a result that became too old.
  std::optional<std::int64_t> published(int module, std::int64_t origin_ns,
                                        const detail::Origins* origins, std::int64_t now_ns);
  /// `lost`: [module] activations that failed or were dropped.
  [[nodiscard]] std::vector<RouteReport> report(const std::vector<std::uint64_t>& lost) const;

 private:
  struct Route {
    RouteReport counts;
    int module = -1;
    std::size_t source = 0;  ///< index into Origins; beyond it: the oldest origin
    std::int64_t last_origin_ns = 0;
    FlowLine* line = nullptr;  ///< null: nobody looks
  };
  std::vector<std::vector<std::size_t>> ends_;  ///< [module] -> routes
  bool single_rate_ = true;
  mutable std::unique_ptr<PiMutex> mutex_ = std::make_unique<PiMutex>();
  std::vector<Route> routes_;  ///< counts guarded by mutex_
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// What every part of a run in one process knows, and none of them changes.
#pragma once

#include <vector>

#include "graph/app_spec.h"
#include "graph/graph.h"
#include "grid/grid.h"
#include "processes/board.h"
#include "processes/plan.h"
#include "session/session.h"
#include "trace/trace.h"

namespace xauto::runtime {

struct Context {
  const detail::AppSpecErased& app;
  const Session& session;
  const Graph& graph;
  const Plan& plan;
  const Grid& grid;
  Board& board;
  trace::Writer* trace = nullptr;  ///< null: nobody asked

  /// This process has the module.
  [[nodiscard]] bool hosts(std::size_t module) const {
    return plan.process_of[module] == session.parts.process;
  }
  [[nodiscard]] bool scheduled() const { return session.scheduling == Scheduling::kXAuto; }
};

/// [module] whether it fires no other one: a release is over when all of these are through.
[[nodiscard]] std::vector<char> sinks(const Graph& graph);

}  // namespace xauto::runtime

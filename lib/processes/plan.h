// SPDX-License-Identifier: Apache-2.0
// Which process of the app hosts which module, and which topics leave their process. Known in every
// process from the graph and the session alone, so nobody has to be told.
#pragma once

#include <vector>

#include <xauto/result.h>

#include "graph/graph.h"
#include "processes/board.h"
#include "session/session.h"

namespace xauto::runtime {

/// Who is where. The same in all processes, from graph and session alone.
struct Plan {
  struct Remote {
    int publisher = 0;         ///< process
    std::vector<int> readers;  ///< processes other than the publisher's; empty: it stays inside
    [[nodiscard]] int reader(int process) const;  ///< its subscriber number, or -1
  };
  int processes = 1;
  std::vector<int> process_of;  ///< [module]; kElsewhere: another host has it
  static constexpr int kElsewhere = -1;
  std::vector<int> host_of;    ///< [module] index into Platform::hosts; empty: the run has no parts
  std::vector<Remote> topics;  ///< [topic]

  /// Whether some module that is here is fired by `topic`, or samples it.
  [[nodiscard]] bool heard_here(const Graph::Topic& topic) const;
  /// ... and another host publishes it.
  [[nodiscard]] bool comes_in(const Graph::Topic& topic) const;

  /// Errors: a module named twice or unknown, a topic that cannot leave its process.
  [[nodiscard]] static Result<Plan> make(const Graph& graph, const detail::AppSpecErased& app,
                                         const Session& session);
};

/// What the board of such an app counts.
[[nodiscard]] BoardShape shape_of(const Plan& plan, const Graph& graph, const Session& session,
                                  std::size_t flows);

}  // namespace xauto::runtime

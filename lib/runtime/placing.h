// SPDX-License-Identifier: Apache-2.0
// Where each XNode runs and by what: the policy's XPU instance, its order constraints as far as
// they can be kept, and the SCHED_FIFO priorities that this process may use. Computed once, before
// anything is built.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "grid/context.h"
#include "model/fifo_range.h"
#include "runtime/worker.h"
#include "session/limits.h"

namespace xauto::runtime {

struct Placing {
  /// What this process may; with `workers` less what is no business of theirs.
  FifoRange fifo, workers;
  /// [table][XNode] of XNodes on real CPUs; empty: nobody schedules.
  std::vector<std::vector<int>> fifo_by_xnode;
  std::vector<int> cores;  ///< the kernel's numbers of the platform's CPUs, in order
  /// Gives the calling thread its priority, if it carries messages to other hosts; empty: none.
  std::function<void()> carriers;
  bool ordered = false;                     ///< order constraints are kept
  std::vector<std::uint32_t> xnode;         ///< [graph node] -> index in app.json
  std::vector<std::vector<int>> xpu;        ///< [table][graph node]; -1: none has an implementation
  std::vector<std::vector<Limits>> limits;  ///< [table][graph node]
  std::vector<char> ends_chain;             ///< [graph node] 1: one does, and its module goes on
  std::string note;  ///< what falls short of what a run would like, for people
  /// What the policy's worst case takes for granted and this run does not keep; see RunReport.
  std::vector<std::string> unkept;

  [[nodiscard]] static Placing of(const Session& session, const Graph& graph);
  /// Of graph node `node` on XPU `at`, as the table runs it; `app` has the longest WCETs.
  [[nodiscard]] Limits limits_of(const Session& session, const AppSpec& app, const Graph& graph,
                                 std::size_t table, std::size_t node, int at) const;
  /// Tells the user before the first release, not after an hour, under which of its assumptions the
  /// policy's worst case does not hold in this run.
  void compare_with_certificate(const Session& session);
  /// The worker of one module on one XPU, for number `index` of the activations in flight. Errors:
  /// the XPU is not here.
  [[nodiscard]] Result<WorkerOptions> worker(const Context& context, std::size_t module, int index,
                                             int at) const;
};

}  // namespace xauto::runtime

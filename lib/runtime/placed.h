// SPDX-License-Identifier: Apache-2.0
// An XNode as a table places it, with what its init has made there; and the chain of a module.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "graph/graph.h"
#include "processes/board.h"
#include "runtime/activation.h"
#include "runtime/urgency.h"
#include "session/limits.h"

namespace xauto::runtime {

class ModuleRuntime;
class Worker;

/// What an XNode's init has made on one XPU, shared by all tables that place it there. Of the worker's
/// execution thread.
struct Instance {
  detail::Made made;
  bool there = false;     ///< init has run
  bool ran_once = false;  ///< exec has
};

/// One XNode as a table places it: everything that its job needs, looked up once. What each job asks
/// for is in the first cache line.
struct alignas(64) Placed {
  Worker* worker = nullptr;
  const detail::ImplSpec* impl = nullptr;
  std::shared_ptr<Instance> here = std::make_shared<Instance>();
  std::uint32_t task = 0;   ///< as coordinators and BPF maps know it, see Session::task
  std::uint32_t table = 0;  ///< that places it so
  int fifo_priority = 0;    ///< SCHED_FIFO priority on a real CPU; 0: leave as it is
  bool limited = false;     ///< see `limit`
  bool watched = false;     ///< how long its jobs take decides which table is next
  bool ends_chain = false;  ///< a chain ends here, and not at the module's end
  Urgency urgency;
  std::uint32_t xnode = 0;  ///< index into app.json's xnodes
  int node = -1;            ///< index into the graph's nodes
  Limits limits;
  XNodeLine* line = nullptr;  ///< of the board
  std::string name;

  /// Its jobs are timed if they have limits, or are watched.
  void limit(const Limits& by, bool watch, XNodeLine& on) {
    limits = by;
    watched = watch;
    line = &on;
    limited = limits.any() || watched;
  }
};

/// The chain of one module as one of its activations runs through it, shared by its workers.
struct NodeRow {
  int module = -1;
  ModuleRuntime* runtime = nullptr;
  Activation* activation = nullptr;
  std::vector<Placed> nodes;  ///< the chain as the first table places it, then as the next one does
  std::size_t tables = 1;
  [[nodiscard]] std::size_t length() const { return nodes.size() / tables; }
  /// As the activation's table places it.
  [[nodiscard]] const Placed* chain() const {
    return tables == 1 ? nodes.data() : nodes.data() + activation->table() * length();
  }
};

}  // namespace xauto::runtime

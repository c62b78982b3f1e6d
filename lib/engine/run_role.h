// SPDX-License-Identifier: Apache-2.0
// How the process begins and ends, by its role (processes/role.h).
//
//            begins         ends
//   alone    at once        when drained
//   hub      all are ready  when drained
//   member   the hub says   the hub says
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include <xauto/result.h>

#include "graph/graph.h"
#include "processes/plan.h"
#include "processes/role.h"
#include "session/run_report.h"
#include "session/session.h"

namespace xauto::runtime {

class Ledger;
class Wiring;
struct Context;

class RunRole : public Role {
 public:
  /// `flows`: see board.h. A member joins its hub here, and gets the board from it.
  [[nodiscard]] static Result<std::unique_ptr<RunRole>> of(const Graph& graph, const Plan& plan,
                                                           const Session& session,
                                                           std::size_t flows,
                                                           std::atomic<bool>& stop);
  /// What the role acts upon, once it is built. Both outlive the role's threads.
  virtual void attach(const Context& context, Wiring& wiring, Ledger& ledger) = 0;

  /// Until the app as a whole is ready. False: it was stopped before.
  [[nodiscard]] virtual Result<bool> begin() { return true; }
  /// Where the accounts are elsewhere: until told to stop. Errors: nobody is there to tell.
  [[nodiscard]] virtual Status wait_stop() { return {}; }
  /// Nothing is in flight any more: ends the others, and the way to them.
  virtual void end() {}
  /// Adds what they had to tell. After `end`.
  virtual void gather(RunReport&) const {}
  /// Hands the report to whoever accounts for it, if that is not this process.
  virtual void hand_over(const RunReport&) {}

  /// A process of the app that does not look after itself for so long is ended. False: there is
  /// nobody to look after. Before the first `looked`.
  virtual bool look_after(int /*process*/, std::int64_t /*silence_ns*/) { return false; }
  /// The watchdog has looked. On its thread.
  virtual void looked(std::int64_t /*now_ns*/) {}
};

}  // namespace xauto::runtime

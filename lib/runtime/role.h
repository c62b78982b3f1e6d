// SPDX-License-Identifier: Apache-2.0
// What differs between the processes of an app: one that is alone, the hub of several, and a
// member. Nothing else in lib/runtime asks which it is.
//
//            board     topics to others  sources, observers, accounts  begins         ends
//   alone    its own   none              here                          at once        when drained
//   hub      shared    shared memory     here                          all are ready  when drained
//   member   shared    shared memory     in the hub                    the hub says   the hub says
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include <xauto/result.h>

#include "graph/graph.h"
#include "processes/board.h"
#include "processes/plan.h"
#include "session/run_report.h"
#include "session/session.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

class Ledger;
class Wiring;
struct Context;

class Role {
 public:
  /// `flows`: see board.h. A member joins its hub here, and gets the board from it.
  [[nodiscard]] static Result<std::unique_ptr<Role>> of(const Graph& graph, const Plan& plan,
                                                        const Session& session, std::size_t flows,
                                                        std::atomic<bool>& stop);
  virtual ~Role() = default;

  [[nodiscard]] virtual const std::shared_ptr<Board>& board() const = 0;
  /// The sources, the observers and the accounts are here.
  [[nodiscard]] virtual bool leads() const { return true; }
  /// Of a topic that leaves its process.
  [[nodiscard]] virtual transport::Link& link(std::size_t topic) const = 0;
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

  /// A sink, or a module where a chain ends, is through with a release. True: told to the process
  /// that has the accounts; false: that is this one. Any thread.
  [[nodiscard]] virtual bool tell(int /*module*/, std::uint64_t /*sequence*/,
                                  std::int64_t /*origin_ns*/, std::int64_t /*now_ns*/,
                                  bool /*lost*/, const detail::Origins* /*origins*/,
                                  bool /*urgent*/) {
    return false;
  }

  /// A process of the app that does not look after itself for so long is ended. False: there is
  /// nobody to look after. Before the first `looked`.
  virtual bool look_after(int /*process*/, std::int64_t /*silence_ns*/) { return false; }
  /// The watchdog has looked. On its thread.
  virtual void looked(std::int64_t /*now_ns*/) {}
};

}  // namespace xauto::runtime

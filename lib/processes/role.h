// SPDX-License-Identifier: Apache-2.0
// What differs between the processes of an app: one that is alone, the hub of several, and a member. Of that, what the
// parts of a run ask (engine/run_role.h: how each begins and ends). Nothing else asks which it is.
//
//            board     topics to others  sources, observers, accounts
//   alone    its own   none              here
//   hub      shared    shared memory     here
//   member   shared    shared memory     in the hub
#pragma once

#include <cstdint>
#include <memory>

#include "graph/graph.h"
#include "processes/board.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

class Role {
 public:
  virtual ~Role() = default;
  [[nodiscard]] virtual const std::shared_ptr<Board>& board() const = 0;
  /// The sources, the observers and the accounts are here.
  [[nodiscard]] virtual bool leads() const { return true; }
  /// Of a topic that leaves its process.
  [[nodiscard]] virtual transport::Link& link(std::size_t topic) const = 0;
  /// A sink, or a module where a chain ends, is through with a release. True: told to the process
  /// that has the accounts; false: that is this one. Any thread.
  [[nodiscard]] virtual bool tell(int /*module*/, std::uint64_t /*sequence*/,
                                  std::int64_t /*origin_ns*/, std::int64_t /*now_ns*/,
                                  bool /*lost*/, const detail::Origins* /*origins*/,
                                  bool /*urgent*/) {
    return false;
  }
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// A process of the app that hosts modules which the deployment isolated. packet.h tells who says
// what.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "graph/graph.h"
#include "processes/board.h"
#include "processes/packet.h"
#include "processes/plan.h"
#include "session/session.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

/// A member's side.
class Member {
 public:
  /// `flows`: see board.h. Says Hello and receives everything up to Begin.
  [[nodiscard]] static Result<std::unique_ptr<Member>> join(const Plan& plan, const Graph& graph,
                                                            const Session& session,
                                                            std::size_t flows);
  [[nodiscard]] const std::shared_ptr<Board>& board() const { return board_; }
  [[nodiscard]] transport::Link& topic(std::size_t index) const { return *topics_.at(index); }
  /// Says Ready and waits for Go. False: told to stop, or the hub is gone.
  [[nodiscard]] Result<bool> ready(const std::atomic<bool>& stop);
  /// A sink module, or one where a chain ends, is through with a release. Any thread.
  void tell(int module, std::uint64_t sequence, std::int64_t origin_ns, std::int64_t now_ns,
            bool lost, const detail::Origins* origins, bool urgent = false);
  /// Until the hub says Stop (true) or is gone (false), or `stop` is set (true).
  [[nodiscard]] bool wait_stop(const std::atomic<bool>& stop);
  void report(const std::string& text);

 private:
  [[nodiscard]] Result<bool> hear(Word wanted, const std::atomic<bool>& stop);
  UniqueFd socket_;
  std::shared_ptr<Board> board_;
  std::vector<std::unique_ptr<transport::Link>> topics_;  ///< [topic]; null: not ours
};

}  // namespace xauto::runtime

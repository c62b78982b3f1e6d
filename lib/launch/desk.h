// SPDX-License-Identifier: Apache-2.0
// Where a run that goes on is asked to change, by `xauto param`: a socket of the
// run's tool, which alone writes the values of parameters (processes/parameters.h). One packet, one
// answer. A client that says nothing is sent away; nobody waits for it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <poll.h>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "processes/board.h"

namespace xauto::launch {

/// Threads: one.
class Desk {
 public:
  static constexpr std::size_t kMaxClients = 8;  ///< then the oldest is sent away
  static constexpr std::int64_t kPatienceNs = 1'000'000'000;

  /// `board_fd`: the board, to be; open for writing; outlives this.
  Desk(UniqueFd listener, int board_fd) : listener_(std::move(listener)), board_fd_(board_fd) {}
  /// What to wait for.
  void add_to(std::vector<pollfd>& fds) const;
  /// Lets in who has come, and answers who has asked.
  void serve(std::int64_t now_ns);

 private:
  /// False: it stays, it has not asked yet.
  [[nodiscard]] bool answer(int client);
  struct Client {
    UniqueFd socket;
    std::int64_t since_ns = 0;
  };
  OneThread thread_;
  UniqueFd listener_;
  const int board_fd_;
  std::shared_ptr<runtime::Board> board_;  ///< null: the app has not made it
  std::vector<Client> clients_;
};

}  // namespace xauto::launch

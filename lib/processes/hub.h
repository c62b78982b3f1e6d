// SPDX-License-Identifier: Apache-2.0
// Process 0 of an app in several processes: brings the others in, hears of releases that ended
// there, and of their deaths. packet.h tells who says what.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/log.h"
#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "graph/graph.h"
#include "processes/board.h"
#include "processes/packet.h"
#include "processes/plan.h"
#include "session/session.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

/// What the hub's engine wants to know. Called on the hub's thread.
class HubHost {
 public:
  virtual ~HubHost() = default;
  virtual void event(const Packet& packet) = 0;
  /// Its process is gone and what it held is released.
  virtual void left(int process) = 0;
  /// It is ready (again): stop standing in for it. Go follows.
  virtual void joins(int process) = 0;
};

/// The hub's side.
class Hub {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Hub>> create(const Plan& plan, const Graph& graph,
                                                           const Session& session,
                                                           std::size_t flows, HubHost& host);
  ~Hub();
  Hub(const Hub&) = delete;
  Hub& operator=(const Hub&) = delete;

  [[nodiscard]] const std::shared_ptr<Board>& board() const { return board_; }
  /// Of a topic that leaves its process.
  [[nodiscard]] transport::Link& topic(std::size_t index) const { return *topics_.at(index); }
  /// Until every member is ready; then they are sent Go. False: `stop` was set.
  [[nodiscard]] Result<bool> wait_ready(const std::atomic<bool>& stop);
  /// Its process does not even watch itself any more (SIGSTOP, say): ends it, which shows as a
  /// death.
  void kill(int process);
  /// Ends the members and returns their reports.
  [[nodiscard]] std::vector<std::string> stop();
  /// Processes that ended before they were told to, each time it happened.
  [[nodiscard]] std::vector<int> deaths() const;

 private:
  enum class State : std::uint8_t { kAbsent, kStarting, kReady, kRunning, kGone };
  struct MemberState {
    State state = State::kAbsent;
    UniqueFd socket;
    std::size_t told = 0;  ///< of introduce(): topics, board, Begin
  };
  Hub(const Plan& plan, const Graph& graph, HubHost& host)
      : plan_(plan), graph_(graph), host_(host), members_(num_members()) {}
  void serve();
  void accept();
  bool hear(int fd);
  [[nodiscard]] bool let_in(int fd, const Packet& packet);
  [[nodiscard]] bool introduce(int process);
  [[nodiscard]] Status tell(int socket, int process, std::size_t step);
  void lose(int process);
  [[nodiscard]] std::size_t num_members() const {
    return static_cast<std::size_t>(plan_.processes);
  }
  [[nodiscard]] int process_of(int fd) const;

  const Plan& plan_;
  const Graph& graph_;
  HubHost& host_;
  std::shared_ptr<Board> board_;
  UniqueFd board_fd_, listener_, wake_;
  std::vector<std::unique_ptr<transport::Link>> topics_;  ///< [topic]; null: stays inside
  std::vector<UniqueFd> strangers_;  ///< connected, not yet said Hello; of serve()
  log::Refusals refusals_{"hub"};    ///< of serve()
  std::thread thread_;

  mutable PiMutex mutex_;
  std::vector<MemberState> members_ XAUTO_GUARDED_BY(mutex_);  ///< [process], 0 unused
  bool begun_ XAUTO_GUARDED_BY(mutex_) = false, stopping_ XAUTO_GUARDED_BY(mutex_) = false;
  std::vector<int> deaths_ XAUTO_GUARDED_BY(mutex_);
  std::vector<std::string> reports_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<std::uint32_t> changes_{0};  ///< a futex, for those who wait for a member's state
  std::atomic<bool> quit_{false};
};

}  // namespace xauto::runtime

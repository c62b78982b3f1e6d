// SPDX-License-Identifier: Apache-2.0
// An app in several processes, all of the same program: process 0, the hub, has the sources, the
// observers, the accounts, and the modules that nobody isolated; each other process, a member, has
// the modules that the session gives it. Topics that leave a process are in shared memory
// (transport/shm_topic.h); all else goes over a socket between hub and member, whose end is how
// each learns of the other's death.
//
//   member: Hello ──► hub                         when the member's process has started
//           ◄── Topic*, Board, Begin              descriptors of what it reads and publishes
//           Ready ──►                             its modules' init is done
//           ◄── Go                                from here on it reads its queues
//           Event* ──►                            a sink module is through with a release
//           ◄── Stop,  Report ──►                 the end: what it has to tell
//
// While a member is dead the hub stands in for its modules: every release that comes to them is
// lost, and told so downstream (Ghost). A member that is started again takes over at Go, where the
// hub left off; its modules begin with a new state.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "runtime/board.h"
#include "runtime/graph.h"
#include "runtime/session.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

/// Who is where. The same in all processes, from graph and session alone.
struct Plan {
  struct Remote {
    int publisher = 0;         ///< process
    std::vector<int> readers;  ///< processes other than the publisher's; empty: it stays inside
    [[nodiscard]] int reader(int process) const;  ///< its subscriber number, or -1
  };
  int processes = 1;
  std::vector<int> process_of;  ///< [module]
  std::vector<Remote> topics;   ///< [topic]

  /// Errors: a module named twice or unknown, a topic that cannot leave its process.
  [[nodiscard]] static Result<Plan> make(const Graph& graph, const detail::AppSpecErased& app,
                                         const Session& session);
};

enum class Word : std::uint32_t {
  kHello = 1,
  kTopic,
  kBoard,
  kBegin,
  kReady,
  kGo,
  kEvent,
  kStop,
  kReport,
  kGone,  ///< supervisor -> hub: this process will not come (back)
};

struct Packet {
  std::uint32_t word = 0;
  std::uint32_t index = 0;  ///< process, topic, or module
  std::uint64_t sequence = 0;
  std::int64_t origin_ns = 0, now_ns = 0;
  std::uint32_t lost = 0;
  std::uint32_t rates = 0;    ///< 1: `origins` is filled in
  detail::Origins origins{};  ///< by source, see Envelope
};
static_assert(sizeof(Packet) == 104);
inline constexpr std::size_t kMaxReportBytes = 32 * 1024;

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
  struct Member {
    State state = State::kAbsent;
    UniqueFd socket;
  };
  Hub(const Plan& plan, const Graph& graph, HubHost& host)
      : plan_(plan), graph_(graph), host_(host) {}
  void serve();
  void accept();
  bool hear(int fd);
  [[nodiscard]] Status introduce(int process);
  void lose(int process);

  const Plan& plan_;
  const Graph& graph_;
  HubHost& host_;
  std::shared_ptr<Board> board_;
  UniqueFd board_fd_, listener_, wake_;
  std::vector<std::unique_ptr<transport::Link>> topics_;  ///< [topic]; null: stays inside
  std::vector<UniqueFd> strangers_;  ///< connected, not yet said Hello; of serve()
  std::thread thread_;

  mutable PiMutex mutex_;
  std::vector<Member> members_;  ///< [process], 0 unused
  bool begun_ = false, stopping_ = false;
  std::vector<int> deaths_;
  std::vector<std::string> reports_;
  std::atomic<std::uint32_t> changes_{0};  ///< a futex, for those who wait for a member's state
  std::atomic<bool> quit_{false};
};

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
            bool lost, const detail::Origins* origins);
  /// Until the hub says Stop (true) or is gone (false), or `stop` is set (true).
  [[nodiscard]] bool wait_stop(const std::atomic<bool>& stop);
  void report(const std::string& text);

 private:
  [[nodiscard]] Result<bool> hear(Word wanted, const std::atomic<bool>& stop);
  UniqueFd socket_;
  std::shared_ptr<Board> board_;
  std::vector<std::unique_ptr<transport::Link>> topics_;  ///< [topic]; null: not ours
};

/// Rings the readers of one topic.
class BoardRinger final : public transport::Ringer {
 public:
  BoardRinger(std::shared_ptr<Board> board, std::vector<int> readers)
      : board_(std::move(board)), readers_(std::move(readers)) {}
  void ring(std::uint32_t subscriber) override { board_->ring(readers_[subscriber]); }

 private:
  std::shared_ptr<Board> board_;
  std::vector<int> readers_;
};

}  // namespace xauto::runtime

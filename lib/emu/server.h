// SPDX-License-Identifier: Apache-2.0
// The emulator's event loop: requests from sockets and the passing of time go into the Machine,
// what happens there goes out when it is due.
//
// With a memory that outlives it, an emulator goes on where the last one died: nobody is told
// anything before the state that it follows from is in the memory. What a client was not told it
// asks for again (client.cc), so nothing is lost; what it asks for twice is done once.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/log.h"
#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "emu/machine.h"
#include "emu/protocol.h"
#include "emu/snapshot.h"
#include "emu/state_memory.h"

namespace xauto::emu {

inline constexpr std::size_t kMaxConnections = 4096;
/// Suspensions and resumptions that are not acknowledged yet, of all clients together.
inline constexpr std::size_t kMaxRequests = 2 * kMaxContexts;

struct ServerOptions {
  std::string address;  ///< abstract socket to listen on
  /// What outlives an emulator, kept by whoever starts the next one: the listening socket, the
  /// memory (StateMemory::make). -1: made here, and none.
  int listener_fd = -1, memory_fd = -1;
  EmulationScript script = {};  ///< without steps: there is none
};

/// Threads: one.
class Server {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Server>> create(const Platform& platform,
                                                              const ServerOptions& options);
  /// Until `stop_fd` becomes readable.
  [[nodiscard]] Status run(int stop_fd);

  /// One packet from a connection; false: the connection is to be closed. Public for the fuzzer,
  /// as is what follows on it: time passes, the state is saved, answers go out.
  bool handle_packet(int connection, const void* data, std::size_t bytes, Nanos now);
  void settle(Nanos now);
  [[nodiscard]] const Machine& machine() const { return machine_; }

 private:
  struct Owner {
    int connection = kAbsent;
    std::uint64_t key = 0;
    pid_t pid = 0;
  };
  struct Connection {
    UniqueFd socket;
    pid_t pid = 0;  ///< 0: not known
  };
  static constexpr int kAbsent = -1;  ///< a context of the emulator before us, not back yet

  OneThread thread_;

  explicit Server(Machine machine) : machine_(std::move(machine)) {}
  Status take_over(const Snapshot& snapshot);
  void accept_connection();
  void drop(int connection);
  void give_up(pid_t process);
  bool open(int connection, const Packet& packet, Nanos now);
  bool rejoin(int connection, const Packet& packet);
  void deliver(Nanos now);
  void save();
  void answer(int connection, const Packet& packet);
  void refuse(int connection, std::uint64_t tag, const Error& error);
  void arm();

  Machine machine_;
  std::optional<StateMemory> memory_;
  Snapshot snapshot_;   ///< kept for its storage
  bool dirty_ = false;  ///< the memory is behind the machine
  UniqueFd epoll_, listener_, timer_;
  std::map<int, Connection> connections_;
  std::map<ContextId, Owner> owner_;  ///< whose context it is
  struct Orphans {
    pid_t pid = 0;
    UniqueFd pidfd;  ///< readable: the process has ended
  };
  std::map<int, Orphans> orphans_;  ///< processes that had contexts of the emulator before us
  /// Suspend and resume requests under way, by the machine's tag.
  struct Request {
    int connection;
    std::uint64_t tag;
  };
  std::map<std::uint64_t, Request> requests_;
  std::uint64_t next_request_ = 1;
  struct Answer {
    int connection;
    Packet packet;
  };
  std::vector<Answer> outbox_;  ///< goes out when the memory has caught up
  std::vector<int> broken_;     ///< could not be written to; dropped after the current event
  std::vector<Event> events_;
  log::Refusals refusals_{"emud"};
};

}  // namespace xauto::emu

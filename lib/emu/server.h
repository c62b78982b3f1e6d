// SPDX-License-Identifier: Apache-2.0
// The emulator's event loop: requests from sockets and the passing of time go into the Machine,
// what happens there goes out when it is due.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "emu/machine.h"
#include "emu/protocol.h"

namespace xauto::emu {

inline constexpr std::size_t kMaxConnections = 4096;

/// Threads: one.
class Server {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Server>> create(const Platform& platform,
                                                              const std::string& address);
  /// Until `stop_fd` becomes readable.
  [[nodiscard]] Status run(int stop_fd);

  /// One packet from a connection; false: the connection is to be closed. Public for the fuzzer.
  bool handle_packet(int connection, const void* data, std::size_t bytes, Nanos now);
  [[nodiscard]] const Machine& machine() const { return machine_; }

 private:
  explicit Server(Machine machine) : machine_(std::move(machine)) {}
  void accept_connection();
  void drop(int connection);
  void deliver(Nanos now);
  void answer(int connection, const Packet& packet);
  void refuse(int connection, std::uint64_t tag, const Error& error);
  void arm();

  Machine machine_;
  UniqueFd epoll_, listener_, timer_;
  std::map<int, UniqueFd> connections_;
  std::map<ContextId, int> owner_;  ///< whose context it is
  /// Suspend and resume requests under way, by the machine's tag.
  struct Request {
    int connection;
    std::uint64_t tag;
  };
  std::map<std::uint64_t, Request> requests_;
  std::uint64_t next_request_ = 1;
  std::vector<int> broken_;  ///< could not be written to; dropped after the current event
  std::vector<Event> events_;
};

}  // namespace xauto::emu

// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 5: the coordinator of one XPU instance, as an event loop around the arbiter.
// Runs in its own process (tools/coordinator). Sleeps unless a worker rings, joins or leaves.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/arbiter.h"
#include "coord/shm_layout.h"

namespace xauto::coord {

struct ServerOptions {
  std::string address;  ///< abstract socket to listen on
  std::string xpu;      ///< "gpu0", for people
  Discipline discipline = Discipline::kPreemptive;
  std::vector<std::string>
      xnodes;  ///< names by index, for people; its size bounds what workers may name
  std::vector<std::pair<std::uint32_t, std::uint32_t>> order;  ///< pairs of XNodes on this XPU
};

/// Threads: one.
class Server {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Server>> create(ServerOptions options);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Serves until `stop_fd` becomes readable. An error is the end of the event loop's own means
  /// (epoll).
  [[nodiscard]] Status run(int stop_fd);

  /// One pass over the shared words: feeds the arbiter what changed and carries out what it
  /// decides. Public for the tests, which call it between the steps of real ports.
  void look();

  /// All state machines in words, as one JSON object.
  [[nodiscard]] std::string status() const;

  /// Bytes from a connection, as run() would receive them; for the fuzzer. Returns whether the
  /// connection stays open.
  bool handle_packet(int connection, const void* data, std::size_t bytes);
  /// A connection that was accepted elsewhere; returns false if there are too many.
  bool adopt_connection(UniqueFd socket);

 private:
  struct Connection {
    UniqueFd socket;
    int slot = -1;  ///< -1: has not said Hello
  };
  struct SlotInfo {
    std::string worker;
    std::vector<std::uint32_t> xnodes;
    UniqueFd command_fd;
    std::uint32_t request = 0;  ///< last seen
    std::uint32_t ack = 0;      ///< last seen
    std::uint32_t command = 0;  ///< last given
    bool used = false;
  };

  explicit Server(ServerOptions options);
  void accept_connection();
  bool welcome(Connection& connection, const void* data, std::size_t bytes);
  void drop(int connection);
  void scan(std::vector<Action>& actions);
  void scan_slot(int slot, std::uint64_t thin, std::vector<Action>& actions);
  [[nodiscard]] bool somebody_waits() const;
  void carry_out(const std::vector<Action>& actions);
  [[nodiscard]] Job job_of(int slot) const;
  [[nodiscard]] std::string xnode_name(std::uint32_t xnode) const;

  ServerOptions options_;
  Arbiter arbiter_;
  UniqueFd epoll_, listener_, memory_fd_, doorbell_;
  Shm shm_;
  std::size_t bytes_ = 0;
  bool fat_ = false;  ///< the owner word is ours, see shm_layout.h
  std::array<SlotInfo, kMaxSlots> slots_;
  std::map<int, Connection> connections_;  ///< by descriptor
  std::vector<std::uint32_t> tracked_;     ///< XNodes that are somebody's order predecessor
  std::uint64_t decisions_ = 0, looks_ = 0;
};

}  // namespace xauto::coord

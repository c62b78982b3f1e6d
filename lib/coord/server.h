// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 5: the coordinator of one XPU instance, as an event loop around the arbiter.
// Runs in its own process (tools/coordinator). Sleeps unless a worker rings, joins or leaves.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/log.h"
#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "coord/arbiter.h"
#include "coord/coordinator_side.h"
#include "coord/pages.h"
#include "coord/protocol.h"
#include "coord/record.h"
#include "coord/shm_layout.h"
#include "model/xpu_status.h"

namespace xauto::coord {

struct ServerOptions {
  std::string address;  ///< abstract socket to listen on
  std::string xpu;      ///< "gpu0", for people
  Discipline discipline = Discipline::kPreemptive;
  std::vector<std::string>
      xnodes;        ///< names by index, for people; its size bounds what workers may name
  OrderPairs order;  ///< pairs of XNodes on this XPU
  /// What outlives a coordinator, made by whoever starts it again when it dies: the listening
  /// socket, the shared memory (empty: the first one fills it), the doorbell. -1: made here.
  int listener_fd = -1, memory_fd = -1, doorbell_fd = -1;
  int record_fd = -1;    ///< of a shared one, likewise: record.h
  bool by_keys = false;  ///< a policy of keys: for people, who are told instants
  int levels = 0;        ///< of kLevels: how many the hardware has
  /// It serves several runs: `listener_fd` is then the socket to the machine's service, which says who comes
  /// (protocol.h); there may be kMaxSharedXNodes, none with a name, and no order.
  bool shared = false;
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

  /// All state machines in words.
  [[nodiscard]] XpuStatus status() const;

  /// Bytes from a connection, as run() would receive them; for the fuzzer. Returns whether the
  /// connection stays open.
  bool handle_packet(int connection, const void* data, std::size_t bytes);
  /// A connection that was accepted elsewhere; returns false if there are too many.
  bool adopt_connection(UniqueFd socket, const Adopt& whose = {});
  /// The run of this lease is not trusted: it gets a page of its own, and has of this XPU what is said there.
  [[nodiscard]] Status regulate(const Regulate& run);
  /// Its workers' connections are closed.
  void end_lease(std::uint32_t lease);

 private:
  struct Connection {
    UniqueFd socket;
    int slot = -1;  ///< -1: has not said Hello
    Adopt whose;    ///< of a shared one: which XNodes it may name
  };
  struct SlotInfo {
    std::string worker;
    std::vector<std::uint32_t> xnodes;
    bool absent = false;          ///< of the coordinator before us; has not come back yet
    RunPage* page = nullptr;      ///< of a run that is not trusted, ...
    pid_t process = 0;            ///< ... whose process that worker is in, ...
    UniqueFd lives;               ///< ... which is that one as long as this says so,
    pid_t named = 0, thread = 0;  ///< ... and what says START there: as it calls it, and as we do
    std::int64_t given_ns = 0;    ///< ... and since when it has the XPU; 0: it has not
  };

  explicit Server(ServerOptions options);
  void accept_connection();
  [[nodiscard]] bool hear_service();
  [[nodiscard]] bool may_name(const Connection& connection, std::uint32_t xnode) const;
  bool welcome(Connection& connection, const void* data, std::size_t bytes);
  [[nodiscard]] const char* fault_of(const Connection& connection, const Hello& hello);
  bool welcome_regulated(Connection& connection, RunPage& page, int slot);
  void lay_hands(const std::vector<Hand>& hands);
  void record(const Hand& hand);
  void hear_doorbell(RunPage& page);
  void set_alarm();
  [[nodiscard]] bool agree_on_order(std::uint32_t num_order);
  void drop(int connection);
  void leave(int slot);
  void take_over_from_predecessor();
  void give_up_absent();
  void wake(const Wakes& wakes);
  [[nodiscard]] bool started_below(std::uint64_t word, int index, std::uint32_t generation) const;
  [[nodiscard]] std::string state_of(int index, bool fat) const;
  [[nodiscard]] int waited_for(bool fat) const;
  [[nodiscard]] std::string xnode_name(std::uint32_t xnode) const;

  ServerOptions options_;
  OneThread thread_;
  UniqueFd epoll_, listener_, memory_fd_, doorbell_, alarm_, record_fd_;
  Record record_;  ///< of a shared one
  Shm shm_;
  std::size_t bytes_ = 0;
  std::optional<Referee<RealAtomics>> referee_;
  std::array<SlotInfo, kMaxSlots> slots_;
  std::map<int, Connection> connections_;   ///< by descriptor
  std::map<std::uint32_t, RunPage> pages_;  ///< by lease
  std::int64_t alarm_ns_ = 0;               ///< what it is set to; 0: it is not
  std::int64_t absent_until_ns_ = 0;        ///< 0: everybody of our predecessor's is back
  int absent_rounds_ = 0;                   ///< of the event loop that are left to come back in
  std::uint64_t looks_ = 0;
  log::Refusals refusals_;
};

}  // namespace xauto::coord

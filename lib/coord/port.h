// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 4: a worker's door to the coordinator of its XPU. START and FINISH are one
// atomic each when nobody else is on the XPU; see shm_layout.h for the protocol.
//
// Threads: `start`, `finish` from the execution thread; `wait_command`, `acknowledge`, `begun`,
// `lend` from the management thread; `skip`, `interrupt` and `beside_ns` from any thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/arbiter.h"
#include "coord/door.h"
#include "coord/protocol.h"
#include "coord/record.h"
#include "coord/shm_layout.h"
#include "coord/socket_watch.h"
#include "coord/worker_side.h"

namespace xauto::coord {

enum class Command : std::uint8_t {
  kSuspend,
  kResume,
  kLost,         ///< the coordinator is gone for good: resume what is suspended, jobs now run
                 ///< unscheduled
  kInterrupted,  ///< `interrupt` was called
  kNothing,      ///< the time is over
};

class alignas(64) Port {
 public:
  /// Registers a worker with the coordinator at `address` (door.h). `order`: pairs (u, v) of XNodes on this XPU,
  /// as the coordinator knows them; one that several runs share knows none. `fifo`: SCHED_FIFO priority of
  /// management threads, also of the one that hears of the coordinator's death; 0: none. `timeout_ms`: for the answer; -1: none.
  [[nodiscard]] static Result<std::unique_ptr<Port>> connect(
      const std::string& address, const std::string& worker,
      const std::vector<std::uint32_t>& xnodes, const OrderPairs& order, int fifo = 0,
      int timeout_ms = -1);
  ~Port();
  Port(const Port&) = delete;
  Port& operator=(const Port&) = delete;

  /// START: returns when the job may run. On a lost coordinator: at once.
  void start(const Job& job) {
    begin(job);
    wait();
  }
  /// START in two steps: others see from `begin` on that the job wants the XPU.
  void begin(const Job& job);
  /// Returns when the job may run. On a lost coordinator: at once.
  void wait();
  /// Whether `wait` would return at once.
  [[nodiscard]] bool may_run() const {
    return !waits_ || lost() ||
           shm_.slots[slot_].coordinator.grant.load(std::memory_order_acquire) == generation_;
  }
  /// Of the XPU's coordinator.
  [[nodiscard]] int slot() const { return slot_; }
  /// Whether others may be waiting for the XPU, or the coordinator decides: then a job that is
  /// ready should `begin` before this one finishes.
  [[nodiscard]] bool contended() const;
  [[nodiscard]] Discipline discipline() const { return rules_.discipline; }
  /// Its coordinator serves several runs.
  [[nodiscard]] bool shared() const { return door_.shared(); }
  /// On which level of the hardware the job that may run shall queue its work; 0: the lowest.
  [[nodiscard]] int level() const { return lost() ? 0 : words_.level(slot_, generation_); }
  /// FINISH of the job last started.
  void finish();
  /// For how long from `since_ns`, when that job was let run, until `until_ns` (both CLOCK_MONOTONIC) the
  /// queue of the one from whom it got the XPU was not suspended yet. 0: it got it from nobody. Any thread.
  [[nodiscard]] std::int64_t beside_ns(std::int64_t since_ns, std::int64_t until_ns) const;
  /// The job that began at `begin_ns` has ended at `end_ns`, and had the XPU for `had_ns` of that: so it is told to who
  /// looks at a coordinator that several runs share. Execution thread.
  void tell_had(std::int64_t begin_ns, std::int64_t end_ns, std::int64_t had_ns) const;
  /// For how long jobs of other runs have had the XPU, as far as they are over; of a coordinator that is not shared 0.
  [[nodiscard]] std::int64_t others_had_ns() const;
  /// As the machine's service says; empty: nobody says. Takes up to 2 s. Any thread.
  [[nodiscard]] Neighbours neighbours() const;
  /// Activations of `xnode` up to and including `sequence` will not be started: nobody waits for
  /// them.
  void skip(std::uint32_t xnode, std::uint64_t sequence);

  /// Blocks until there is a command for the management thread.
  [[nodiscard]] Command wait_command(int timeout_ms = -1);
  /// The command last received was carried out (or, for a suspension, could not be).
  void acknowledge(bool succeeded);
  /// The worker's job that began as activation `sequence` of `xnode` and is not over.
  struct Begun {
    std::uint32_t generation;
    Key key;
  };
  [[nodiscard]] std::optional<Begun> begun(std::uint32_t xnode, std::uint64_t sequence) const;
  /// That job, which is suspended, goes by `key` from now on, if that is the more urgent: a more
  /// urgent job waits for its work.
  void lend(const Begun& job, Key key);
  /// Makes `wait_command` return kInterrupted and `start` return: for shutdown.
  void interrupt();

  [[nodiscard]] bool lost() const { return lost_.load(std::memory_order_relaxed); }

 private:
  Port() = default;
  [[nodiscard]] Status introduce(const Hello& hello, int timeout_ms);
  [[nodiscard]] Status watch_socket();
  [[nodiscard]] bool rejoin();
  void tell(const Finished& finished);
  void ring();
  void ring_manager(int slot);

  // Each job asks for these.
  Words<RealAtomics> words_;
  Shm shm_;
  Job job_;
  int slot_ = -1;
  std::uint32_t generation_ = 0;
  std::uint32_t first_xnode_ = 0;  ///< what XNode 0 is to the coordinator
  bool waits_ = false;             ///< begun, and not known to run
  std::atomic<bool> took_{false};  ///< the job last started may have got the XPU from another
  std::atomic<bool> lost_{false}, interrupted_{false};
  std::atomic<bool> ended_{false};  ///< the socket: its coordinator is dead
  std::uint32_t pending_command_ = 0;
  Rules rules_;
  Door door_;
  Hello hello_;
  UniqueFd socket_, memory_, doorbell_, record_fd_;
  Record record_;  ///< of a shared coordinator; of one whose run is not trusted there is none
  std::shared_ptr<SocketWatch> watch_;
  std::size_t bytes_ = 0;
};

}  // namespace xauto::coord

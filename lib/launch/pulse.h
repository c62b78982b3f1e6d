// SPDX-License-Identifier: Apache-2.0
// Does a daemon still live? One that is stopped (SIGSTOP, a debugger) or goes round in circles dies
// for nobody: who needs it would wait for ever. The xauto tool looks now and then, and ends one
// that has had something to do for kHungNs and has not got round to it; then it is started again as
// after any death.
#pragma once

#include <cstdint>
#include <string>
#include <utility>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "coord/shm_layout.h"

namespace xauto::launch {

inline constexpr std::int64_t kHungNs = 2'000'000'000;
inline constexpr std::int64_t kLookEveryNs = 1'000'000'000;
inline constexpr std::int64_t kPingEveryNs = 2'000'000'000;

/// The rule, without a clock.
class Stall {
 public:
  /// `busy`: there is something to do; `progress` changes whenever the observed gets round to it.
  /// True: it has not for kHungNs.
  bool look(bool busy, std::uint64_t progress, std::int64_t now_ns);

 private:
  std::int64_t since_ns_ = -1;  ///< -1: nothing to do when last looked at
  std::uint64_t progress_ = 0;
};

/// A coordinator's. It is asked nothing: whether it has something to do is in its memory (it says
/// that it sleeps, and a ring takes that back) and in the queue of its socket. Threads: one.
class Pulse {
 public:
  /// `memory_fd`: the coordinator's, mapped read-only. `listener_fd` outlives the object.
  [[nodiscard]] static Result<Pulse> of(int memory_fd, int listener_fd);
  Pulse() = default;
  Pulse(Pulse&& other) noexcept;
  Pulse& operator=(Pulse&& other) noexcept;
  ~Pulse();

  /// Whether `coordinator` hangs. A Pulse that observes nothing never says so.
  [[nodiscard]] bool hangs(pid_t coordinator, std::int64_t now_ns);
  /// No job has its XPU, or wants it, but for one of this slot.
  [[nodiscard]] bool idle(int but) const;

 private:
  const coord::Header* header_ = nullptr;
  OneThread thread_;
  int listener_fd_ = -1;
  Stall stall_;
};

/// The emulator's. It has work in many sockets, so it is asked, every kPingEveryNs. Threads: one.
class Ping {
 public:
  explicit Ping(std::string address) : address_(std::move(address)) {}
  /// Whether the emulator has left a question unanswered for too long. Never waits.
  [[nodiscard]] bool hangs(std::int64_t now_ns);

 private:
  void hear();

  OneThread thread_;
  std::string address_;
  UniqueFd socket_;
  bool asked_ = false;
  std::uint64_t answers_ = 0;
  std::int64_t next_ns_ = 0;
  Stall stall_;
};

}  // namespace xauto::launch

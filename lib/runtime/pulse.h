// SPDX-License-Identifier: Apache-2.0
// Does a coordinator still live? One that is stopped (SIGSTOP, a debugger) or goes round in circles
// dies for nobody: its workers would wait for ever. The xauto tool looks now and then, and ends one
// that has had something to do for kHungNs and has not got to its event loop; then it is started
// again as after any death.
//
// Nothing is asked of the coordinator: whether it has something to do is in its memory (it says
// that it sleeps, and a ring takes that back) and in the queue of its socket.
#pragma once

#include <cstdint>

#include <sys/types.h>

#include <xauto/result.h>

#include "coord/shm_layout.h"

namespace xauto::runtime {

inline constexpr std::int64_t kHungNs = 2'000'000'000;

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

/// Threads: one.
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

 private:
  const coord::Header* header_ = nullptr;
  int listener_fd_ = -1;
  Stall stall_;
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Shared memory that outlives the emulator: the xauto tool keeps it, nobody else has it. Two
// copies of the state take turns. The one that is written is first declared empty and numbered
// last, so that a death in the middle leaves the other one to be found: stores of a process that
// is killed are there up to some instruction and none beyond it.
#pragma once

#include <optional>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "emu/snapshot.h"

namespace xauto::emu {

/// Threads: one.
class StateMemory {
 public:
  /// A sealed memfd of the right size, without a state.
  [[nodiscard]] static Result<UniqueFd> make();
  /// Takes over `fd`.
  [[nodiscard]] static Result<StateMemory> map(UniqueFd fd);
  StateMemory(StateMemory&& other) noexcept;
  StateMemory& operator=(StateMemory&&) = delete;
  ~StateMemory();

  /// The newest complete state; nullopt: nothing has been saved yet.
  [[nodiscard]] Result<std::optional<Snapshot>> load() const;
  void save(const Snapshot& snapshot);

  struct Layout;

 private:
  StateMemory(UniqueFd fd, Layout* layout) : fd_(std::move(fd)), layout_(layout) {}
  UniqueFd fd_;
  OneThread thread_;
  Layout* layout_;
};

}  // namespace xauto::emu

// SPDX-License-Identifier: Apache-2.0
// This process's own TSGs and DLA queues, suspended by itself with the drivers' ioctls: no module,
// no privilege. What xauto.ko does beside it is done here as far as a process can (docs/kernel.md):
// what the driver has enabled is suspended again, a context that does not leave its engine is left
// alone. What a process cannot: resume while it hangs. Its death is its own resume, as the driver
// closes what was open.
#pragma once

#include <cstdint>
#include <map>

#include <xauto/result.h>

#include "kernel/patience.h"
#include "kernel/queue_files.h"

namespace xauto::kernel {

/// Threads: one at a time. Several of them must not have the same file.
class OwnQueues {
 public:
  using Handle = std::uint32_t;

  OwnQueues();
  OwnQueues(const OwnQueues&) = delete;
  OwnQueues& operator=(const OwnQueues&) = delete;
  /// Resumes all; tries for kLastMs where a driver refuses.
  ~OwnQueues();
  static constexpr int kLastMs = 200;

  /// It runs then: a DLA's slot may have been left suspended by whom it belonged to. kInvalid: the
  /// file is no TSG and no DLA queue by what its driver says. A file that was taken gives its handle.
  [[nodiscard]] Result<Handle> take(const QueueFile& file);
  void give_back(Handle handle);

  /// When it returns none of a TSG's work runs, and none of a DLA queue's tasks is started. An error
  /// leaves it running. kTimeout: it did not leave the engine; kUnavailable: it did not before, so
  /// it was not tried, or it is closed.
  [[nodiscard]] Status suspend(Handle handle);
  /// What is closed needs none. After an error `again` goes on trying.
  [[nodiscard]] Status resume(Handle handle);

  /// Tells the drivers again what is suspended, and what could not be resumed. At least every
  /// kAgainMs while anything is.
  void again();
  /// Something could not be resumed.
  [[nodiscard]] bool owes() const;
  /// It did not leave its engine for 1.5 s in all: it is never preempted again.
  [[nodiscard]] bool gated(Handle handle) const;

 private:
  struct Queue {
    QueueFile file;
    bool suspended = false, owed = false;
    std::uint32_t slot = 0;    ///< a DLA's, when it was suspended
    std::int64_t told_ns = 0;  ///< by a command
    /// From its suspension until it runs again: a TSG outlives its file while a channel is bound, so
    /// one that was closed meanwhile would stay disabled.
    Duplicate held = {};
  };
  [[nodiscard]] static Status tell_suspend(Queue& queue, bool first);
  [[nodiscard]] static Status tell_resume(Queue& queue);
  std::map<Handle, Queue> queues_;
  Handle last_ = 0;
};

}  // namespace xauto::kernel

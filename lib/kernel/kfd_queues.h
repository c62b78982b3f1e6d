// SPDX-License-Identifier: Apache-2.0
// Queues of amdkfd (AMD GPUs under ROCm), this process's own, suspended by itself: UPDATE_QUEUE with
// a percentage of 0 and back, as ROCm's own runtime does. The ring's address and size must be told
// again each time, so libxauto_watch.so sees the queues made. Read in Linux's source, not run on
// hardware: docs/backends.md.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include <xauto/result.h>

#include "kernel/patience.h"
#include "kernel/queue_files.h"

namespace xauto::kernel {

/// libxauto_watch.so stands before libc's ioctl in this process.
[[nodiscard]] bool kfd_is_watched();

/// This process's queues, with `target` "kfd:QUEUE:MADE" and its descriptor of /dev/kfd.
[[nodiscard]] std::vector<QueueFile> find_kfd_queues();

/// Threads: one at a time.
class KfdQueues {
 public:
  using Handle = std::uint32_t;

  KfdQueues() = default;
  KfdQueues(const KfdQueues&) = delete;
  KfdQueues& operator=(const KfdQueues&) = delete;
  /// Resumes all.
  ~KfdQueues();

  /// A queue that was taken gives its handle. kUnavailable: it is not there.
  [[nodiscard]] Result<Handle> take(const QueueFile& queue);
  void give_back(Handle handle);

  /// When it returns the queue is off its engine. An error leaves it running. kTimeout, kUnavailable:
  /// as OwnQueues.
  [[nodiscard]] Status suspend(Handle handle);
  /// As the process wanted it.
  [[nodiscard]] Status resume(Handle handle);

  /// Suspends again what the process has updated itself, and tries again what could not be resumed.
  void again();
  [[nodiscard]] bool owes() const;
  [[nodiscard]] bool gated(Handle handle) const { return queues_.at(handle).patience.gated(); }

 private:
  struct Queue {
    QueueFile file;
    bool suspended = false, owed = false;
    std::uint32_t updates = 0;  ///< the process's own, when it was suspended
    Patience patience = {};
  };
  std::map<Handle, Queue> queues_;
  Handle last_ = 0;
};

}  // namespace xauto::kernel

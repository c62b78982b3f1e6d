// SPDX-License-Identifier: Apache-2.0
// Contexts of i915 (Intel GPUs), this process's own, put on priority levels by itself: the driver
// suspends nothing, but its hardware preempts by the priority that a context has when a request is
// queued. No descriptor shows them: libxauto_watch.so sees them made. Read in Linux's source, not
// run on hardware: docs/backends.md.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include <xauto/result.h>

#include "kernel/queue_files.h"

namespace xauto::kernel {

/// libxauto_watch.so stands before libc's ioctl in this process.
[[nodiscard]] bool i915_is_watched();

/// This process's contexts, with `target` "i915:CONTEXT:MADE" and their descriptor of the node.
[[nodiscard]] std::vector<QueueFile> find_i915_contexts();

/// How many levels the first GPU of i915 gives this process; it is asked. 0: there is none, it is
/// not ours to open, or its scheduler does not preempt. With GuC submission two, or three with
/// CAP_SYS_NICE.
[[nodiscard]] int i915_levels();

/// Threads: one at a time.
class I915Contexts {
 public:
  using Handle = std::uint32_t;

  I915Contexts() = default;
  I915Contexts(const I915Contexts&) = delete;
  I915Contexts& operator=(const I915Contexts&) = delete;
  /// Gives all back.
  ~I915Contexts();

  /// A context that was taken gives its handle. kUnavailable: it is not there.
  [[nodiscard]] Result<Handle> take(const QueueFile& context);
  /// With the priority that its process had given it.
  void give_back(Handle handle);

  /// What it queues from now on has this level; 0 is the lowest. An error leaves it where it was.
  /// kUnavailable: it is gone; kPermission: this level needs CAP_SYS_NICE; kInvalid: there is none.
  [[nodiscard]] Status level(Handle handle, int level);

 private:
  struct Context {
    QueueFile file;
    bool three_buckets = false;
    int given = 0;  ///< its priority when it was taken
  };
  std::map<Handle, Context> contexts_;
  Handle last_ = 0;
};

}  // namespace xauto::kernel

// SPDX-License-Identifier: Apache-2.0
// The client of xauto.ko: GPU TSGs and DLA queues, registered, suspended and resumed over generic
// netlink. The rules (owners, watchdog, permission) are in include/uapi/xauto/netlink.h.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <sys/types.h>
#include <uapi/xauto/netlink.h>

#include <xauto/result.h>

namespace xauto::kernel {

enum class QueueType : std::uint32_t {
  kGpuTsg = XAUTO_QUEUE_GPU_TSG,
  kDla = XAUTO_QUEUE_DLA,
  // Not xauto.ko's:
  kRmGroup = 0x100,  ///< a channel group of NVIDIA's RM
  kKfdQueue,         ///< a queue of amdkfd's
  kI915Context,      ///< a context of i915's
};

/// A queue as this connection knows it.
struct RegisteredQueue {
  std::uint32_t handle = 0;  ///< of this connection
  std::uint32_t queue = 0;   ///< of the machine; in the module's events
};

/// One step of a batch.
struct QueueOp {
  xauto_action action = XAUTO_ACTION_SUSPEND;
  std::uint32_t handle = 0;
  std::uint32_t value = 0;  ///< time slice in us, or interleave level
};

struct QueueInfo {
  std::uint32_t queue = 0;
  QueueType type = QueueType::kGpuTsg;
  pid_t pid = 0;
  std::uint32_t handle = 0;  ///< 0: not registered on this connection
  bool suspended = false;
  std::uint32_t votes = 0;         ///< owners that want it suspended
  std::uint32_t timeslice_us = 0;  ///< 0: not asked, or it has none
  std::uint64_t suspends = 0, resumes = 0, errors = 0;
  std::uint64_t suspended_ns = 0, cost_ns = 0, cost_max_ns = 0;
  std::uint64_t escapes = 0;   ///< found running although suspended
  std::uint32_t stuck_ms = 0;  ///< preemptions that took 100 ms or more, in sum
  bool gated = false;          ///< stuck_ms reached its limit: it is never preempted again
};

/// A connection is an owner: what it suspended runs again when it is destroyed, however that
/// happens. Threads: one at a time; connections of several threads do not wait for each other.
class QueueControl {
 public:
  /// kUnavailable when xauto.ko is not loaded.
  [[nodiscard]] static Result<QueueControl> open();
  QueueControl(QueueControl&&) noexcept;
  QueueControl& operator=(QueueControl&&) noexcept;
  ~QueueControl();

  /// `fd`: this process's; it may be closed afterwards. `pid`: whose queue it is, 0: ours. For
  /// another process's queue see queue_files.h.
  [[nodiscard]] Result<RegisteredQueue> register_queue(QueueType type, int fd, pid_t pid = 0);
  /// Resumes it first.
  [[nodiscard]] Status unregister(std::uint32_t handle);

  /// When they return: none of a TSG's work runs; none of a DLA queue's tasks is started. kTimeout:
  /// a context that did not leave the engine, or the watchdog bit meanwhile; kUnavailable: one that did not before, so it was not
  /// tried (`gated` says whether it ever is), or one whose process is gone.
  [[nodiscard]] Status suspend(std::uint32_t handle);
  [[nodiscard]] Status resume(std::uint32_t handle);
  /// In order, up to the first that fails; the error tells which. At most XAUTO_MAX_OPS.
  [[nodiscard]] Status control(std::span<const QueueOp> ops);
  /// The same, with the time that each step spent in the driver, ns.
  [[nodiscard]] Result<std::vector<std::uint64_t>> control_timed(std::span<const QueueOp> ops);

  /// 10..60000 ms without a message and the kernel resumes what this connection suspended; it
  /// starts at XAUTO_WATCHDOG_DEFAULT_MS. 0 switches it off and needs CAP_SYS_NICE.
  [[nodiscard]] Status set_watchdog(std::uint32_t timeout_ms);
  /// kTimeout once, after it has expired: what was suspended then and not since runs.
  [[nodiscard]] Status feed_watchdog();

  [[nodiscard]] Result<QueueInfo> query(std::uint32_t handle);
  /// Every queue that this user may see, as of one moment: when queues come or go while the list
  /// is read, it is read again, `tries` times in all. kUnavailable when none of them was quiet.
  [[nodiscard]] Result<std::vector<QueueInfo>> list(int tries = 8);

  /// For a test that sends what this class would not: the descriptor and the family's number.
  [[nodiscard]] int descriptor() const;
  [[nodiscard]] int family() const;

 private:
  struct Socket;
  explicit QueueControl(std::unique_ptr<Socket> socket);
  [[nodiscard]] Status send_ops(std::span<const QueueOp> ops, int flags);
  std::unique_ptr<Socket> socket_;
};

}  // namespace xauto::kernel

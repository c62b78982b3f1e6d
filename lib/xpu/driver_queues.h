// SPDX-License-Identifier: Apache-2.0
// GPUs and DLAs behind a driver: what `init` returned is opaque (a CUcontext, a cudlaDevHandle);
// contexts.h finds the queues behind it, and a door suspends those: xauto.ko (kernel_queue.cc), or
// this process itself (own_queue.cc).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <xauto/result.h>

#include "kernel/queue_files.h"
#include "xpu/backend.h"

namespace xauto::xpu {

/// Who tells the driver. What it has suspended runs again when it dies. Threads: one at a time.
class QueueDoor {
 public:
  using Handle = std::uint32_t;

  virtual ~QueueDoor() = default;
  /// Taking what was taken gives the handle that it has.
  [[nodiscard]] virtual Result<Handle> take(const kernel::QueueFile& file) = 0;
  /// Resumes it first.
  virtual void give_back(Handle handle) = 0;
  /// In order, up to the first that fails. As Backend::preempt and restore; kUnavailable: one of them
  /// was closed; kTimeout: it did not leave its engine.
  [[nodiscard]] virtual Status suspend(const std::vector<Handle>& handles) = 0;
  [[nodiscard]] virtual Status resume(const std::vector<Handle>& handles) = 0;
  /// Of a driver that suspends nothing: Backend::level.
  [[nodiscard]] virtual Status level(const std::vector<Handle>&, int /*level*/) { return {}; }
  /// It did not leave its engine in time so often that nobody tries any more.
  [[nodiscard]] virtual bool gated(Handle handle) = 0;
  /// Backend::still_wanted, again_ms.
  [[nodiscard]] virtual Status still_wanted() = 0;
  [[nodiscard]] virtual int again_ms() const { return kStillWantedMs; }
  /// A resume failed and is tried again by still_wanted().
  [[nodiscard]] virtual bool owes() const { return false; }
};

[[nodiscard]] std::unique_ptr<Backend> over_door(const XpuId& xpu, kernel::QueueType type,
                                                 std::unique_ptr<QueueDoor> door);
/// Of nvgpu or nvdla.
[[nodiscard]] std::unique_ptr<Backend> over_door(const XpuId& xpu, std::unique_ptr<QueueDoor> door);

}  // namespace xauto::xpu

// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 7: how the queue behind a scheduling handle is suspended and resumed. One
// file per kind of XPU; nothing above this interface knows which it is.
#pragma once

#include <memory>

#include <xauto/result.h>
#include <xauto/xpu.h>

namespace xauto::xpu {

/// Threads: one management thread at a time.
class Backend {
 public:
  virtual ~Backend() = default;
  /// Suspends the work queued behind `handle`: when it returns, none of it runs. Suspending what is
  /// suspended is no error. An error leaves it running.
  [[nodiscard]] virtual Status preempt(const SchedHandle& handle) = 0;
  /// Lets it run again. Resuming what runs is no error.
  [[nodiscard]] virtual Status restore(const SchedHandle& handle) = 0;
};

/// Contexts of xauto-emud, over a connection of its own (emulated.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_emulated();
/// XPUs that cannot be preempted: both calls are refused (gate.cc).
[[nodiscard]] std::unique_ptr<Backend> make_gate();

}  // namespace xauto::xpu

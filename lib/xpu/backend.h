// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 7: how the queue behind a scheduling handle is suspended and resumed. One
// file per kind of XPU; nothing above this interface knows which it is.
#pragma once

#include <memory>

#include <xauto/result.h>
#include <xauto/xpu.h>

#include "base/context_counts.h"
#include "base/core_levels.h"

namespace xauto::xpu {

inline constexpr int kStillWantedMs = 250;

/// Threads: one management thread at a time.
class Backend {
 public:
  virtual ~Backend() = default;
  /// Called right before and right after the `init` whose handle will be given to the others; on
  /// the execution thread. What the first returns lives until the second has returned, or `init`
  /// has failed: while it does no other `init` of this kind runs in this process.
  using Init = std::shared_ptr<const void>;
  [[nodiscard]] virtual Result<Init> before_init() { return Init(); }
  [[nodiscard]] virtual Status attach(const SchedHandle&) { return {}; }
  /// Suspends the work queued behind `handle`: when it returns, none of it runs. Suspending what is
  /// suspended is no error. An error leaves it running.
  [[nodiscard]] virtual Status preempt(const SchedHandle& handle) = 0;
  /// Lets it run again. Resuming what runs is no error.
  [[nodiscard]] virtual Status restore(const SchedHandle& handle) = 0;
  /// On an XPU that preempts by levels, before the job runs: on this level the hardware shall have
  /// what it queues; 0 is the lowest. On the execution thread. An error leaves it where it was.
  [[nodiscard]] virtual Status level(const SchedHandle&, int /*level*/) { return {}; }
  /// The job may run now; it has run, and will say FINISH. On the execution thread. `first`: it is
  /// the first of its stage, which may open more of what `handle` names.
  virtual void admitted(const SchedHandle&, bool /*first*/) {}
  virtual void finishing(const SchedHandle&, bool /*first*/) {}
  /// Where to count what cannot be promised. Before any `init`, and `counts` outlives the backend.
  virtual void count_in(ContextCounts& /*counts*/) {}
  /// The execution thread does the work itself, and Linux preempts it unseen.
  [[nodiscard]] virtual bool on_thread() const { return false; }
  /// What is suspended shall stay so: called at least every again_ms(). A backend whose device has a
  /// watchdog feeds it; one whose driver may resume by itself suspends again. An error: it has run
  /// meanwhile; kTimeout: the watchdog was fed too late, and it is suspended again.
  [[nodiscard]] virtual Status still_wanted() { return {}; }
  /// Less than 0: it need not be called. Asked after each call of one of these.
  [[nodiscard]] virtual int again_ms(bool suspended) { return suspended ? kStillWantedMs : -1; }
};

/// What emu::Context::open finds on a thread of a run: taken where the run is set up, and entered by
/// each thread that calls the user's code.
class Surroundings {
 public:
  [[nodiscard]] static Surroundings of_this_thread();
  void enter() const;

 private:
  std::shared_ptr<const void> site_;
};

// kind.h says which of these an XPU of a run has.

/// Contexts of xauto-emud, over a connection of its own (emulated.cc). `scheduled` false: it only
/// checks the handles.
[[nodiscard]] Result<std::unique_ptr<Backend>> make_emulated(bool scheduled = true);
/// What `init` returned for an emulated XPU: a context of the emulator's, or an error that says how
/// the XPU becomes real.
[[nodiscard]] Status check_emulated(const SchedHandle& handle);
/// What `init` returned for a core: what computes in `exec`, or an error that says so
/// (cpu_thread.cc).
[[nodiscard]] Status check_thread(const SchedHandle& handle);
/// A core of this machine (cpu_thread.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_cpu_thread(const XpuId& xpu);
/// A core where the coordinator follows keys, which SCHED_FIFO does not know (cpu_by_keys.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_cpu_by_keys(const XpuId& xpu);
/// What the app suspends itself, by SchedHandle::custom (custom.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_custom(const XpuId& xpu);
/// What the app puts on priority levels itself, by SchedHandle::on_levels (custom.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_on_levels(const XpuId& xpu);
/// A GPU or DLA of nvgpu or nvdla, or of the emulator modules, through xauto.ko (kernel_queue.cc).
/// kUnavailable when the module is not loaded.
[[nodiscard]] Result<std::unique_ptr<Backend>> make_kernel_queue(const XpuId& xpu);
/// The same by this process itself (own_queue.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_own_queue(const XpuId& xpu);
/// A GPU of NVIDIA's RM driver, by this process itself (rm.cc). kUnavailable: it is not watched.
[[nodiscard]] Result<std::unique_ptr<Backend>> make_rm(const XpuId& xpu);
/// A GPU of amdkfd, likewise (kfd.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_kfd(const XpuId& xpu);
/// A GPU of i915, likewise; it has levels (i915.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_i915(const XpuId& xpu);
/// XPUs that cannot be preempted: both calls are refused (gate.cc).
[[nodiscard]] Result<std::unique_ptr<Backend>> make_gate();

}  // namespace xauto::xpu

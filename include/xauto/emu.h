// SPDX-License-Identifier: Apache-2.0
// Contexts on emulated XPUs (process xauto-emud): what a CUcontext is on a Jetson. Work is a
// duration on a virtual processor, so an 8-core Orin with a GPU and two DLAs fits a laptop. On a
// CPU that is real in this run, the work keeps that CPU busy for as long instead.
#pragma once

#include <chrono>
#include <memory>

#include <xauto/result.h>
#include <xauto/xpu.h>

namespace xauto::emu {

/// One context (a TSG, a DLA queue, a thread on an emulated core). Work submitted to it runs in
/// order. Threads: one user at a time; suspending it is the runtime's business, on another
/// connection.
class Context {
 public:
  /// Connects to the emulator of this session. kUnavailable when this process was not started by an
  /// `xauto` tool with that XPU emulated, or the emulator is gone.
  [[nodiscard]] static Result<Context> open(const XpuId& xpu);

  /// A context that was moved from may only be assigned to or destroyed.
  Context(Context&&) noexcept;
  /// As the constructor.
  Context& operator=(Context&&) noexcept;
  ~Context();

  /// Submits work that takes `duration` alone on the XPU and waits until the XPU has finished it.
  /// Takes longer in wall time when the XPU is shared or the context is suspended. `duration` is
  /// not negative. An emulator that dies meanwhile is replaced, and the work goes on; error:
  /// kUnavailable when it is gone for good.
  [[nodiscard]] Status run(std::chrono::microseconds duration);

  /// What `init` returns, so that the runtime can suspend this context.
  [[nodiscard]] SchedHandle handle() const;

 private:
  struct Connection;
  explicit Context(std::unique_ptr<Connection> connection);
  std::unique_ptr<Connection> connection_;
};

}  // namespace xauto::emu

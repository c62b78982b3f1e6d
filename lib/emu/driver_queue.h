// SPDX-License-Identifier: Apache-2.0
// Work for a GPU or DLA through its driver's device node, as a duration: what the emulator modules
// (kmod/emu/) take. The queue behind it is a real TSG or DLA queue of the kernel's, so suspending
// it goes the way it goes on a Jetson.
#pragma once

#include <chrono>
#include <cstdint>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto::emu {

/// Threads: one at a time.
class DriverQueue {
 public:
  /// A TSG with one channel, opened as CUDA does: ctrl node, OPEN_TSG, OPEN_CHANNEL, BIND_CHANNEL.
  [[nodiscard]] static Result<DriverQueue> open_gpu();
  /// A queue on DLA `instance`.
  [[nodiscard]] static Result<DriverQueue> open_dla(int instance);

  [[nodiscard]] Status submit(std::chrono::nanoseconds duration);
  /// Until all that was submitted has finished; `timeout_ms` < 0: for ever. False: not yet.
  [[nodiscard]] Result<bool> wait(int timeout_ms = -1);
  /// Pieces of work finished so far.
  [[nodiscard]] Result<std::uint64_t> finished() const;

  /// The descriptor that is the TSG or the DLA queue.
  [[nodiscard]] int descriptor() const { return queue_.get(); }
  /// Of a TSG: its channel's.
  [[nodiscard]] int channel() const { return channel_.get(); }

 private:
  bool gpu_ = false;
  UniqueFd queue_;    ///< TSG, or DLA ctrl node
  UniqueFd channel_;  ///< GPU only
};

}  // namespace xauto::emu

// SPDX-License-Identifier: Apache-2.0
// CLOCK_TAI beside CLOCK_MONOTONIC, by which this host's keys are read: they go alike, as long as nobody sets the clock.
#pragma once

#include <cstdint>
#include <optional>

#include "base/unique_fd.h"

namespace xauto::launch {

/// CLOCK_TAI less CLOCK_MONOTONIC, ns: of several readings the one that took least.
[[nodiscard]] std::int64_t tai_offset_ns();
/// CLOCK_TAI less CLOCK_REALTIME of this kernel, s; 0 where nobody has set it.
[[nodiscard]] std::int64_t kernel_tai_s();

/// Who disciplines this host's clock, and how well, by the kernel's word (adjtimex(2)).
struct ClockState {
  bool synchronised = false;  ///< STA_UNSYNC is not set
  std::int64_t max_error_us = 0, estimated_error_us = 0;
  double rate_ppm = 0;  ///< by how much its rate is corrected
  std::int64_t tai_s = 0;
};
[[nodiscard]] std::optional<ClockState> clock_state();

/// Whether the clock is set meanwhile: the kernel tells (timerfd_create(2), TFD_TIMER_CANCEL_ON_SET). Threads: one.
class ClockWatch {
 public:
  ClockWatch();
  /// To wait for; -1: the kernel has no such timer.
  [[nodiscard]] int fd() const { return timer_.get(); }
  /// By how much the clock was set since the last call, ns, where it was.
  [[nodiscard]] std::optional<std::int64_t> step_ns();

 private:
  void arm();
  UniqueFd timer_;
  std::int64_t offset_ns_;
};

}  // namespace xauto::launch

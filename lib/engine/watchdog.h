// SPDX-License-Identifier: Apache-2.0
// The thread that notices jobs which do not return.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>

#include <xauto/result.h>

#include "base/alarm.h"

namespace xauto::runtime {

/// Calls `look` every `period_ns`, and whenever its alarm asks for it, on a thread of its own.
class Watchdog {
 public:
  /// `late_ns`: by how much it woke too late.
  using Look = std::function<void(std::int64_t now_ns, std::int64_t late_ns)>;
  /// kUnavailable: there is no thread, or no timer.
  [[nodiscard]] static Result<std::unique_ptr<Watchdog>> start(std::shared_ptr<Alarm> alarm,
                                                               std::int64_t period_ns, Look look);
  ~Watchdog() { stop(); }
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;
  void stop();

 private:
  Watchdog() = default;
  std::shared_ptr<Alarm> alarm_;
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace xauto::runtime

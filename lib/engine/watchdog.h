// SPDX-License-Identifier: Apache-2.0
// The thread that notices jobs which do not return.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>

#include <xauto/result.h>

namespace xauto::runtime {

/// Calls `look` every `period_ns` on a thread of its own.
class Watchdog {
 public:
  /// kUnavailable: there is none.
  [[nodiscard]] static Result<std::unique_ptr<Watchdog>> start(
      std::int64_t period_ns, std::function<void(std::int64_t now_ns)> look);
  ~Watchdog() { stop(); }
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;
  void stop();

 private:
  Watchdog() = default;
  std::atomic<std::uint32_t> quit_{0};  ///< a futex
  std::thread thread_;
};

}  // namespace xauto::runtime

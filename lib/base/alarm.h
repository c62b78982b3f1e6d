// SPDX-License-Identifier: Apache-2.0
// An instant that one thread sleeps until. Any thread may bring it forward, and wakes nobody by that: a timer of the
// kernel's is set anew, as often as that is asked for.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto {

/// Instants are of CLOCK_MONOTONIC, in ns.
class Alarm {
 public:
  /// kUnavailable: there are no more files.
  [[nodiscard]] static Result<std::shared_ptr<Alarm>> make();
  /// The sleeper, before it looks at what others want of it: who asks from here on is heard.
  void set(std::int64_t at_ns);
  /// Any thread: not later than that.
  void by(std::int64_t at_ns);
  /// The sleeper. Returns the instant that it woke for.
  [[nodiscard]] std::int64_t wait() const;

 private:
  explicit Alarm(UniqueFd timer) : timer_(std::move(timer)) {}
  void arm() const;

  UniqueFd timer_;
  std::atomic<std::int64_t> due_ns_{0};
};

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Time. Everything that measures uses CLOCK_MONOTONIC in nanoseconds.
#pragma once

#include <cerrno>
#include <cstdint>
#include <ctime>

namespace xauto {

/// How often whoever waits looks at what nobody rings for: a stop, another process's death.
inline constexpr std::int64_t kLookNs = 50'000'000;

/// Any clock of clock_gettime(2).
[[nodiscard]] inline std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  clock_gettime(clock, &now);
  return static_cast<std::int64_t>(now.tv_sec) * 1'000'000'000 + now.tv_nsec;
}

[[nodiscard]] inline std::int64_t now_ns() {
  return clock_ns(CLOCK_MONOTONIC);
}

/// The same clock as of the last tick, up to 10 ms ago: for a fifth of the price.
[[nodiscard]] inline std::int64_t coarse_now_ns() {
  return clock_ns(CLOCK_MONOTONIC_COARSE);
}

/// Sleeps until `due` on the same clock. False, at once: it has passed.
inline bool sleep_until_ns(std::int64_t due) {
  // The kernel would set a timer and give the CPU away, even for an instant that has passed.
  if (now_ns() >= due) return false;
  const timespec until{due / 1'000'000'000, due % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  return true;
}

}  // namespace xauto

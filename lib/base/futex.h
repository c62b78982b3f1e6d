// SPDX-License-Identifier: Apache-2.0
// Futexes on words in memory shared between processes, and on those of one process.
#pragma once

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <ctime>

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto {

/// Sleeps while `word` holds `expected`, at most `limit_ns` (negative: without limit): the default
/// is only a net for the one case that has no waker, a peer that died between its store and its
/// wake. Callers loop on their condition. False: that time was over.
inline bool futex_wait(std::atomic<std::uint32_t>& word, std::uint32_t expected,
                       std::int64_t limit_ns = kLookNs) {
  const timespec limit{limit_ns / 1'000'000'000, limit_ns % 1'000'000'000};
  return syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&word), FUTEX_WAIT, expected,
                 limit_ns < 0 ? nullptr : &limit, nullptr, 0) == 0 ||
         errno != ETIMEDOUT;
}

inline void futex_wake(std::atomic<std::uint32_t>& word, int waiters) {
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&word), FUTEX_WAKE, waiters, nullptr, nullptr,
          0);
}

/// The same for words that only this process knows: the kernel has no page to look up. Without a
/// limit by default, since such a waker cannot die alone.
inline void futex_wait_local(std::atomic<std::uint32_t>& word, std::uint32_t expected,
                             std::int64_t limit_ns = -1) {
  const timespec limit{limit_ns / 1'000'000'000, limit_ns % 1'000'000'000};
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&word), FUTEX_WAIT_PRIVATE, expected,
          limit_ns < 0 ? nullptr : &limit, nullptr, 0);
}

/// Sleeps while `word` holds `expected`, at most until `due_ns` of CLOCK_MONOTONIC.
inline void futex_wait_until_local(std::atomic<std::uint32_t>& word, std::uint32_t expected,
                                   std::int64_t due_ns) {
  const timespec until{due_ns / 1'000'000'000, due_ns % 1'000'000'000};
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&word),
          FUTEX_WAIT_BITSET | FUTEX_PRIVATE_FLAG, expected, &until, nullptr,
          FUTEX_BITSET_MATCH_ANY);
}

inline void futex_wake_local(std::atomic<std::uint32_t>& word, int waiters) {
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&word), FUTEX_WAKE_PRIVATE, waiters, nullptr,
          nullptr, 0);
}

/// For shared words that only count: whoever slept on the value before wakes.
inline void futex_advance(std::atomic<std::uint32_t>& word, int waiters) {
  word.fetch_add(1);
  futex_wake(word, waiters);
}

}  // namespace xauto

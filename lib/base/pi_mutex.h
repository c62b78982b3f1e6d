// SPDX-License-Identifier: Apache-2.0
// A mutex with priority inheritance: a management thread that waits for one held by a less urgent
// execution thread lends it its priority. BasicLockable; `Guard` locks a scope.
//
// The kernel's own protocol (futex(2), PI futexes): the word is the owner's thread id, and the
// kernel adds FUTEX_WAITERS. pthread's mutex does the same at twice the price where nobody waits
// (10 against 5 ns a pair, measured), and a release takes three of them per XNode.
#pragma once

#include <atomic>
#include <cstdint>

#include "base/thread_safety.h"

namespace xauto {

class XAUTO_CAPABILITY("mutex") PiMutex {
 public:
  PiMutex() = default;
  PiMutex(const PiMutex&) = delete;
  PiMutex& operator=(const PiMutex&) = delete;

  void lock() XAUTO_ACQUIRE() {
    std::uint32_t free = 0;
    const std::uint32_t self = self_id();
    if (self == 0 || !word_.compare_exchange_strong(free, self, std::memory_order_acquire,
                                                    std::memory_order_relaxed))
      lock_slowly();
  }
  void unlock() XAUTO_RELEASE() {
    std::uint32_t self = self_id();
    if (!word_.compare_exchange_strong(self, 0, std::memory_order_release,
                                       std::memory_order_relaxed))
      unlock_slowly();
  }

 private:
  static std::uint32_t& self_id() {
    static thread_local constinit std::uint32_t id = 0;  // 0: not asked yet
    return id;
  }
  void lock_slowly();
  void unlock_slowly();

  std::atomic<std::uint32_t> word_{0};
};

class XAUTO_SCOPED_CAPABILITY Guard {
 public:
  explicit Guard(PiMutex& mutex) XAUTO_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~Guard() XAUTO_RELEASE() { mutex_.unlock(); }
  Guard(const Guard&) = delete;
  Guard& operator=(const Guard&) = delete;

 private:
  PiMutex& mutex_;
};

}  // namespace xauto

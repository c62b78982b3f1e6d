// SPDX-License-Identifier: Apache-2.0
#include "base/pi_mutex.h"

#include <cerrno>

#include <linux/futex.h>
#include <pthread.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/check.h"

namespace xauto {

void PiMutex::lock_slowly() {
  std::uint32_t& self = self_id();
  if (self == 0) {
    // The child of a fork has another id.
    static const int kForgets = pthread_atfork(nullptr, nullptr, [] { self_id() = 0; });
    (void)kForgets;
    self = static_cast<std::uint32_t>(gettid());
  }
  std::uint32_t free = 0;
  while (!word_.compare_exchange_strong(free, self, std::memory_order_acquire)) {
    XAUTO_CHECK((free & FUTEX_TID_MASK) != self);  // it would wait for itself
    auto* word = reinterpret_cast<std::uint32_t*>(&word_);
    if (syscall(SYS_futex, word, FUTEX_LOCK_PI_PRIVATE, 0, nullptr, nullptr, 0) == 0) {
      (void)word_.load(std::memory_order_acquire);
      return;
    }
    XAUTO_CHECK(errno != ESRCH);               // its owner has ended with it
    if (errno == ENOSYS) (void)sched_yield();  // a kernel without CONFIG_FUTEX_PI
    free = 0;
  }
}

void PiMutex::unlock_slowly() {
  // Somebody waits, so this bit is set; what we did must be seen by whom the kernel gives it to.
  word_.fetch_or(FUTEX_WAITERS, std::memory_order_release);
  auto* word = reinterpret_cast<std::uint32_t*>(&word_);
  const long done = syscall(SYS_futex, word, FUTEX_UNLOCK_PI_PRIVATE, 0, nullptr, nullptr, 0);
  XAUTO_CHECK(done == 0);
}

}  // namespace xauto

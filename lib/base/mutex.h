// SPDX-License-Identifier: Apache-2.0
// std::mutex as clang's analysis sees it, for threads among which none is urgent. `Lock` is also what a
// std::condition_variable_any waits with. Where urgent threads wait, it is PiMutex.
#pragma once

#include <mutex>

#include "base/thread_safety.h"

namespace xauto {

class XAUTO_CAPABILITY("mutex") Mutex {
 public:
  void lock() XAUTO_ACQUIRE() { mutex_.lock(); }
  void unlock() XAUTO_RELEASE() { mutex_.unlock(); }

 private:
  std::mutex mutex_;
};

class XAUTO_SCOPED_CAPABILITY Lock {
 public:
  explicit Lock(Mutex& mutex) XAUTO_ACQUIRE(mutex) : lock_(mutex) {}
  ~Lock() XAUTO_RELEASE() = default;
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;

  void lock() XAUTO_ACQUIRE() { lock_.lock(); }
  void unlock() XAUTO_RELEASE() { lock_.unlock(); }

 private:
  std::unique_lock<Mutex> lock_;
};

}  // namespace xauto

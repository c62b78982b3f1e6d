// SPDX-License-Identifier: Apache-2.0
// What a lock guards, for clang's -Wthread-safety (cmake/warnings.cmake: the presets asan and tsan);
// nothing to other compilers. https://clang.llvm.org/docs/ThreadSafetyAnalysis.html
//
// And who may call a class that says "Threads: one".
#pragma once

#include <thread>

#include "base/check.h"

#ifdef __clang__
#define XAUTO_THREAD_SAFETY(what) __attribute__((what))
#else
#define XAUTO_THREAD_SAFETY(what)
#endif

#define XAUTO_CAPABILITY(name) XAUTO_THREAD_SAFETY(capability(name))
#define XAUTO_SCOPED_CAPABILITY XAUTO_THREAD_SAFETY(scoped_lockable)
#define XAUTO_GUARDED_BY(mutex) XAUTO_THREAD_SAFETY(guarded_by(mutex))
#define XAUTO_ACQUIRE(...) XAUTO_THREAD_SAFETY(acquire_capability(__VA_ARGS__))
#define XAUTO_RELEASE(...) XAUTO_THREAD_SAFETY(release_capability(__VA_ARGS__))
#define XAUTO_REQUIRES(...) XAUTO_THREAD_SAFETY(requires_capability(__VA_ARGS__))
#define XAUTO_EXCLUDES(...) XAUTO_THREAD_SAFETY(locks_excluded(__VA_ARGS__))
/// With the reason beside it: the analysis does not see why this is right.
#define XAUTO_NO_THREAD_SAFETY XAUTO_THREAD_SAFETY(no_thread_safety_analysis)

namespace xauto {

/// Of a class that one thread may call: the thread that calls `check` first owns it from then on.
/// Only builds without NDEBUG look (Debug, the sanitizers).
class OneThread {
 public:
#ifdef NDEBUG
  void check() const {}
  void give_away() {}
#else
  void check() const {
    if (owner_ == std::thread::id()) owner_ = std::this_thread::get_id();
    XAUTO_CHECK(owner_ == std::this_thread::get_id());
  }
  /// The next thread that calls becomes the owner; the caller orders the two.
  void give_away() {
    owner_ = {};
  }

 private:
  mutable std::thread::id owner_;
#endif
};

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Threads that compute for one answer: as many as the system gives, joined however their owner ends. What one of
// them throws (memory that ends), join() throws again.
#pragma once

#include <exception>
#include <thread>
#include <utility>
#include <vector>

#include "base/mutex.h"
#include "base/thread.h"

namespace xauto::solver {

inline constexpr int kMostThreads = 64;  ///< that one answer is computed by

class Threads {
 public:
  Threads() = default;
  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;
  ~Threads() { wait(); }

  /// False: there is none for it.
  template <class F>
  [[nodiscard]] bool start(F run) {
    auto thread = start_thread([this, run = std::move(run)] {
      try {
        run();
      } catch (...) {
        const Lock lock(mutex_);
        thrown_ = std::current_exception();
      }
    });
    if (thread) threads_.push_back(std::move(*thread));
    return thread.has_value();
  }
  void join() {
    wait();
    std::exception_ptr thrown;
    {
      const Lock lock(mutex_);
      thrown = std::exchange(thrown_, nullptr);
    }
    if (thrown) std::rethrow_exception(thrown);
  }

 private:
  void wait() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }

  std::vector<std::thread> threads_;
  Mutex mutex_;
  std::exception_ptr thrown_ XAUTO_GUARDED_BY(mutex_);
};

}  // namespace xauto::solver

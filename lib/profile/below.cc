// SPDX-License-Identifier: Apache-2.0
#include "profile/below.h"

#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {
namespace {

class Thread final : public Below {
 public:
  ~Thread() override {
    {
      const std::lock_guard lock(mutex_);
      quit_ = true;
      wanted_ = false;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

  [[nodiscard]] Status start(const std::vector<int>& cores) {
    XAUTO_ASSIGN(thread_, start_thread([this, cores] {
                   const Status pinned = rt::pin_to_cores(cores);
                   serve(pinned);
                 }));
    return {};
  }

  void begin(std::function<Status()> job) override {
    std::unique_lock lock(mutex_);
    job_ = std::move(job);
    wanted_ = true;
    changed_.notify_all();
    changed_.wait(lock, [&] { return calling_; });
  }

  Status end() override {
    std::unique_lock lock(mutex_);
    wanted_ = false;
    changed_.notify_all();
    changed_.wait(lock, [&] { return !calling_; });
    return status_;
  }

 private:
  /// `ready`: whether it can run jobs at all.
  void serve(const Status& ready) {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [&] { return quit_ || wanted_; });
      if (quit_) return;
      calling_ = true;
      status_ = ready;
      changed_.notify_all();
      while (wanted_ && status_) {
        lock.unlock();
        Status status = job_();
        lock.lock();
        status_ = std::move(status);
      }
      changed_.wait(lock, [&] { return !wanted_; });
      calling_ = false;
      changed_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::function<Status()> job_;  ///< changes only while nobody calls it
  bool wanted_ = false, calling_ = false, quit_ = false;
  Status status_;
  std::thread thread_;
};

}  // namespace

Result<std::unique_ptr<Below>> Below::start(const std::vector<int>& cores) {
  auto made = std::make_unique<Thread>();
  XAUTO_TRY(made->start(cores));
  return std::unique_ptr<Below>(std::move(made));
}

}  // namespace xauto::runtime

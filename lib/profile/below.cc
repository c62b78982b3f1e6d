// SPDX-License-Identifier: Apache-2.0
#include "profile/below.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {
namespace {

class Thread {
 public:
  Thread() = default;
  Thread(const Thread&) = delete;
  Thread& operator=(const Thread&) = delete;
  ~Thread() {
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

  void begin(std::function<Status()> job) {
    std::unique_lock lock(mutex_);
    job_ = std::move(job);
    wanted_ = true;
    changed_.notify_all();
    changed_.wait(lock, [&] { return calling_; });
  }

  Status end() {
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

class Threads final : public Below {
 public:
  explicit Threads(std::vector<int> cores) : cores_(std::move(cores)) {}

  Status begin(std::vector<std::function<Status()>> jobs) override {
    while (threads_.size() < jobs.size()) {
      auto made = std::make_unique<Thread>();
      XAUTO_TRY(made->start(cores_));
      threads_.push_back(std::move(made));
    }
    at_work_ = jobs.size();
    for (std::size_t i = 0; i < at_work_; ++i) threads_[i]->begin(std::move(jobs[i]));
    return {};
  }

  Status end() override {
    Status ended;
    for (std::size_t i = 0; i < at_work_; ++i)
      if (Status one = threads_[i]->end(); ended) ended = std::move(one);
    at_work_ = 0;
    return ended;
  }

 private:
  std::vector<int> cores_;
  std::vector<std::unique_ptr<Thread>> threads_;
  std::size_t at_work_ = 0;
};

}  // namespace

std::unique_ptr<Below> Below::on(const std::vector<int>& cores) {
  return std::make_unique<Threads>(cores);
}

std::vector<std::vector<int>> sets_below(const std::vector<std::vector<int>>& others, int levels) {
  std::vector<std::vector<int>> sets;
  std::size_t most = 0;
  for (const std::vector<int>& module : others) {
    for (const int one : module) sets.push_back({one});
    most = std::max(most, module.size());
  }
  const std::size_t modules = others.size(),
                    together = std::min(modules, static_cast<std::size_t>(std::max(0, levels - 1)));
  if (together < 2) return sets;
  // Each module is on each of these levels once, and each XNode in some set.
  for (std::size_t turn = 0; turn < modules * most; ++turn) {
    std::vector<int>& set = sets.emplace_back();
    for (std::size_t i = 0; i < together; ++i) {
      const std::vector<int>& module = others[(turn + i) % modules];
      set.push_back(module[turn / modules % module.size()]);
    }
  }
  return sets;
}

}  // namespace xauto::runtime

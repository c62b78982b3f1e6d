// SPDX-License-Identifier: Apache-2.0
// Who runs a job that is ready, where one job runs at a time and nothing of it belongs to a thread:
// any execution thread of the workers on that XPU.
//
// Each job that is ready has a thread at once, since its START is to be seen at once, and a thread
// can wait for one XPU's grant only. There always is one: a worker has one thread and at most one
// job, so whoever brings a job finds a thread without, or one that is about to ask for the next.
//
// Exception: what a thread makes ready itself stays with it (Worker's lane) as long as that thread has
// the XPU, or waits for it with something that is at least as urgent.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "base/pi_mutex.h"
#include "base/ring.h"
#include "coord/rule.h"

namespace xauto::runtime {

class Worker;

/// A job that is ready: the activation of `worker`, from position `node` of its chain on.
struct Ready {
  Worker* worker = nullptr;
  std::size_t node = 0;
  coord::Key key = 0;
  bool begun = false;  ///< its START is out
};

/// Threads: any.
/// What an execution thread has to do, if it belongs to a crew. Threads: that one, apart from `take`.
class Lane {
 public:
  void reserve(std::size_t jobs) { jobs_.reserve(jobs); }
  [[nodiscard]] bool empty() const { return jobs_.empty(); }
  /// It became ready on this thread, and stays with it.
  void push(const Ready& job) { jobs_.push_back(job); }
  /// The most urgent one, as the XPU itself would be given.
  [[nodiscard]] Ready pop();
  [[nodiscard]] const std::vector<Ready>& all() const { return jobs_; }
  void clear() { jobs_.clear(); }

  /// The crew's choice, while this thread has nothing to do. Another thread, before it wakes this one.
  void take(const Ready& job) { taken_ = job; }
  [[nodiscard]] const Ready& taken() const { return taken_; }
  /// The crew knows this thread as one that has nothing to do, before that is so.
  bool asked = false;

 private:
  std::vector<Ready> jobs_;
  Ready taken_;
};

class Crew {
 public:
  /// The thread of `worker` is one of them, and has nothing to do.
  void join(Worker& worker);
  /// To the thread of its own worker if that has nothing to do, or else to another one.
  void submit(const Ready& job);
  /// What the thread of `worker`, which is through with its own, is to go on with. None: it is told
  /// by Worker::take.
  [[nodiscard]] std::optional<Ready> next(Worker& worker);
  /// That thread has something to do after all. False: it is being told what.
  [[nodiscard]] bool leave(Worker& worker);

 private:
  PiMutex mutex_;
  std::vector<Worker*> idle_ XAUTO_GUARDED_BY(mutex_);
  Ring<Ready> waiting_ XAUTO_GUARDED_BY(mutex_);  ///< for a thread that is about to ask
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
#include "runtime/crew.h"

#include <algorithm>
#include <vector>

#include "runtime/worker.h"

namespace xauto::runtime {

Ready Lane::pop() {
  coord::Next next;
  for (std::size_t i = 0; i < jobs_.size(); ++i)
    next.consider({jobs_[i].key, 0, static_cast<int>(i)});  // who was ready first is before it
  const auto at = jobs_.begin() + next.slot();
  const Ready job = *at;
  jobs_.erase(at);
  return job;
}

void Crew::join(Worker& worker) {
  const Guard lock(mutex_);
  idle_.push_back(&worker);
}

void Crew::submit(const Ready& job) {
  Worker* thread = nullptr;
  {
    const Guard lock(mutex_);
    if (idle_.empty()) {
      waiting_.push_back(job);
      return;
    }
    const auto own = std::find(idle_.begin(), idle_.end(), job.worker);
    const auto chosen = own != idle_.end() ? own : idle_.end() - 1;
    thread = *chosen;
    *chosen = idle_.back();
    idle_.pop_back();
  }
  thread->take(job);
}

std::optional<Ready> Crew::next(Worker& worker) {
  const Guard lock(mutex_);
  if (waiting_.empty()) {
    idle_.push_back(&worker);
    return std::nullopt;
  }
  const Ready job = waiting_.front();
  waiting_.pop_front();
  return job;
}

bool Crew::leave(Worker& worker) {
  const Guard lock(mutex_);
  return std::erase(idle_, &worker) > 0;
}

}  // namespace xauto::runtime

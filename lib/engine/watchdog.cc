// SPDX-License-Identifier: Apache-2.0
#include "engine/watchdog.h"

#include <algorithm>
#include <utility>

#include "base/clock.h"
#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {

Result<std::unique_ptr<Watchdog>> Watchdog::start(std::shared_ptr<Alarm> alarm,
                                                  std::int64_t period_ns, Look look) {
  std::unique_ptr<Watchdog> dog(new Watchdog);
  dog->alarm_ = std::move(alarm);
  XAUTO_ASSIGN(dog->thread_, start_thread([dog = dog.get(), period_ns, look = std::move(look)] {
                 rt::set_thread_name("xauto/watch");
                 dog->alarm_->set(now_ns() + period_ns);
                 for (std::int64_t asleep_ns = now_ns(); !dog->quit_.load(); asleep_ns = now_ns()) {
                   const std::int64_t due_ns = dog->alarm_->wait();
                   const std::int64_t now = now_ns();
                   dog->alarm_->set(now + period_ns);
                   // It may have been asked for an instant that was over.
                   if (!dog->quit_.load()) look(now, now - std::max(due_ns, asleep_ns));
                 }
               }));
  return dog;
}

void Watchdog::stop() {
  quit_.store(true);
  if (alarm_) alarm_->by(0);
  if (thread_.joinable()) thread_.join();
}

}  // namespace xauto::runtime

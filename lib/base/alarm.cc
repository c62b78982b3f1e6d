// SPDX-License-Identifier: Apache-2.0
#include "base/alarm.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <sys/timerfd.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto {

Result<std::shared_ptr<Alarm>> Alarm::make() {
  UniqueFd timer(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC));
  if (!timer)
    return fail(ErrorCode::kUnavailable, std::string("there is no timer: ") + strerror(errno));
  return std::shared_ptr<Alarm>(new Alarm(std::move(timer)));
}

void Alarm::set(std::int64_t at_ns) {
  due_ns_.store(at_ns);
  arm();
}

void Alarm::by(std::int64_t at_ns) {
  std::int64_t due_ns = due_ns_.load();
  do {
    if (due_ns <= at_ns) return;
  } while (!due_ns_.compare_exchange_weak(due_ns, at_ns));
  arm();
}

/// Whoever sets the timer last has seen the last instant: who was overtaken in between does it again.
void Alarm::arm() const {
  for (std::int64_t due_ns = due_ns_.load(), armed_ns = -1; armed_ns != due_ns;
       due_ns = due_ns_.load()) {
    const std::int64_t at_ns = std::max<std::int64_t>(1, due_ns);  // 0 would be never
    const itimerspec at = {{}, {at_ns / 1'000'000'000, at_ns % 1'000'000'000}};
    timerfd_settime(timer_.get(), TFD_TIMER_ABSTIME, &at, nullptr);
    armed_ns = due_ns;
  }
}

std::int64_t Alarm::wait() const {
  std::uint64_t times = 0;
  while (read(timer_.get(), &times, sizeof times) < 0 && errno == EINTR) {
  }
  return due_ns_.load();
}

}  // namespace xauto

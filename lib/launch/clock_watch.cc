// SPDX-License-Identifier: Apache-2.0
#include "launch/clock_watch.h"

#include <cerrno>
#include <cstdlib>
#include <ctime>

#include <sys/timerfd.h>
#include <sys/timex.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto::launch {
namespace {

/// Two readings that differ by less say nothing of a step.
constexpr std::int64_t kReadingNs = 20'000;

}  // namespace

std::int64_t tai_offset_ns() {
  std::int64_t best_ns = INT64_MAX, offset_ns = 0;
  for (int i = 0; i < 20; ++i) {
    const std::int64_t before = now_ns(), tai = clock_ns(CLOCK_TAI), after = now_ns();
    if (after - before >= best_ns) continue;
    best_ns = after - before;
    offset_ns = tai - before - best_ns / 2;
  }
  return offset_ns;
}

std::int64_t kernel_tai_s() {
  const auto state = clock_state();
  return state ? state->tai_s : 0;
}

std::optional<ClockState> clock_state() {
  timex now{};
  if (adjtimex(&now) < 0) return std::nullopt;
  return ClockState{.synchronised = (now.status & STA_UNSYNC) == 0,
                    .max_error_us = now.maxerror,
                    .estimated_error_us = now.esterror,
                    .rate_ppm = static_cast<double>(now.freq) / 65536,
                    .tai_s = now.tai};
}

ClockWatch::ClockWatch()
    : timer_(timerfd_create(CLOCK_REALTIME, TFD_NONBLOCK | TFD_CLOEXEC)),
      offset_ns_(tai_offset_ns()) {
  if (timer_) arm();
}

void ClockWatch::arm() {
  itimerspec far{};
  far.it_value.tv_sec = clock_ns(CLOCK_REALTIME) / 1'000'000'000 + 10LL * 365 * 86'400;
  if (timerfd_settime(timer_.get(), TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET, &far, nullptr) !=
      0)
    timer_.reset();
}

std::optional<std::int64_t> ClockWatch::step_ns() {
  std::uint64_t times = 0;
  if (!timer_ || read(timer_.get(), &times, sizeof times) >= 0 || errno != ECANCELED)
    return std::nullopt;
  arm();
  const std::int64_t before_ns = std::exchange(offset_ns_, tai_offset_ns());
  const std::int64_t by_ns = offset_ns_ - before_ns;
  // Set to what it was, as some do now and then.
  if (std::abs(by_ns) < kReadingNs) return std::nullopt;
  return by_ns;
}

}  // namespace xauto::launch

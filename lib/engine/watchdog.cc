// SPDX-License-Identifier: Apache-2.0
#include "engine/watchdog.h"

#include <climits>
#include <utility>

#include "base/clock.h"
#include "base/futex.h"
#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {

Result<std::unique_ptr<Watchdog>> Watchdog::start(std::int64_t period_ns,
                                                  std::function<void(std::int64_t)> look) {
  std::unique_ptr<Watchdog> dog(new Watchdog);
  XAUTO_ASSIGN(dog->thread_, start_thread([&quit = dog->quit_, period_ns, look = std::move(look)] {
                 rt::set_thread_name("xauto/watch");
                 while (quit.load() == 0) {
                   futex_wait_local(quit, 0, period_ns);
                   if (quit.load() == 0) look(now_ns());
                 }
               }));
  return dog;
}

void Watchdog::stop() {
  quit_.store(1);
  futex_wake_local(quit_, INT_MAX);
  if (thread_.joinable()) thread_.join();
}

}  // namespace xauto::runtime

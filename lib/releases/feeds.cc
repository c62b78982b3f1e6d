// SPDX-License-Identifier: Apache-2.0
#include "releases/feeds.h"

#include "base/clock.h"
#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {

Result<std::unique_ptr<Feeds>> Feeds::start(Interop& interop, std::vector<Feed> feeds, int fifo) {
  std::unique_ptr<Feeds> made(new Feeds(interop, std::move(feeds)));
  XAUTO_ASSIGN(made->thread_, start_thread([f = made.get(), fifo] {
                 rt::set_thread_name("xauto/feeds");
                 rt::set_timer_slack_1ns();
                 if (fifo > 0) (void)rt::set_fifo(fifo);
                 f->run();
               }));
  return made;
}

Feeds::~Feeds() {
  if (!thread_.joinable()) return;
  stop_.store(true);
  thread_.join();
}

void Feeds::run() {
  while (!stop_.load()) {
    std::int64_t wake_ns = now_ns() + kLookNs;
    for (Feed& feed : feeds_) {
      if (!interop_.waits(feed.topic)) continue;
      if (const std::int64_t earliest_ns = feed.pace.earliest_ns(); now_ns() < earliest_ns) {
        wake_ns = std::min(wake_ns, earliest_ns);
        continue;
      }
      // The certificate counts with when jobs can begin, so it is the arrival that gives the grid.
      auto message = interop_.take(feed.topic).message;
      if (message == nullptr) continue;  // it was refused
      feed.pace.passed(now_ns());
      (void)feed.inlet->push(std::move(message));  // full: it is left out, and counted as such
    }
    interop_.wait(wake_ns, [this] {
      return std::none_of(feeds_.begin(), feeds_.end(), [this](const Feed& feed) {
        return interop_.waits(feed.topic) && feed.pace.earliest_ns() <= now_ns();
      });
    });
  }
}

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Sources that programs outside feed, in a run by keys: their messages come when they come, and are
// then what a driver's are that pushes (graph/inlet.h). Only as fast as app.json allows: nobody
// outside makes the app work more than its certificate counts with. What comes faster waits, and is
// replaced by what is newer.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <thread>
#include <vector>

#include "graph/inlet.h"
#include "processes/interop.h"
#include "runtime/grid.h"

namespace xauto::runtime {

/// The generic cell rate algorithm (ITU-T I.371, virtual scheduling): lets through whatever has a
/// period, a jitter and a clock as stated, and no more than that in the long run.
class Pace {
 public:
  Pace(std::int64_t period_ns, std::int64_t jitter_ns, std::int64_t ppm)
      : interval_ns_(period_ns -
                     static_cast<std::int64_t>(static_cast<__int128>(period_ns) * ppm / 1'000'000)),
        jitter_ns_(jitter_ns) {}

  /// When the next one may be let through at the earliest.
  [[nodiscard]] std::int64_t earliest_ns() const { return due_ns_ - jitter_ns_; }
  /// One was, not before that.
  void passed(std::int64_t at_ns) { due_ns_ = std::max(due_ns_, at_ns) + interval_ns_; }

 private:
  const std::int64_t interval_ns_, jitter_ns_;
  std::int64_t due_ns_ = 0;
};

class Feeds {
 public:
  struct Feed {
    std::size_t topic;
    detail::Inlet* inlet;
    Pace pace;
  };
  /// Its thread has SCHED_FIFO priority `fifo`; 0: an ordinary one. All outlive it.
  Feeds(Interop& interop, std::vector<Feed> feeds, int fifo);
  ~Feeds();
  Feeds(const Feeds&) = delete;
  Feeds& operator=(const Feeds&) = delete;

 private:
  void run();

  Interop& interop_;
  std::vector<Feed> feeds_;  ///< of the thread
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Sources that programs outside feed. Nobody outside makes the app work more than its sources' periods
// say: what comes faster waits, and is replaced by what is newer.
//
// In a run by keys (`Feeds`) messages come when they come, and are then what a driver's are that pushes
// (graph/inlet.h), only as fast as app.json allows and the certificate counts with. Without keys the
// releases of an app of one rate are on a grid that follows the feeder (`FedGrid`).
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "graph/inlet.h"
#include "grid/grid.h"
#include "processes/interop.h"

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

/// The grid of releases of an app of one rate without keys: it follows the feeder.
///
/// A release that waited for its messages puts the next one a period after they came. When it took them
/// is of no account: else each wake-up and each decoding made the grid later, and where they add up
/// to a period a message is lost. Where they lay there already, the next one is a little sooner than a
/// period after this one was due. So
///
///   - what was late once does not hold up all to come: the grid goes back by as much, a 16th of a
///     period at a time;
///   - of a feeder whose clock is a little faster than ours nothing is lost: beyond that, it goes
///     forward by a thousandth of a period, ten times what two crystals differ by.
///
/// In the long run there is no more than a release per 0.999 periods, whatever comes.
class FedGrid {
 public:
  /// By how much the grid moves after a release that was due at `due_ns`. `came_ns`: until when it
  /// waited; nullopt: its messages lay there.
  std::int64_t move_ns(std::int64_t due_ns, std::int64_t period_ns,
                       std::optional<std::int64_t> came_ns) {
    const std::int64_t late_ns = came_ns ? std::max<std::int64_t>(*came_ns - due_ns, 0) : 0;
    behind_ns_ = std::min(behind_ns_ + late_ns, period_ns);
    if (came_ns) return late_ns;
    const std::int64_t back_ns = std::min(behind_ns_, period_ns / 16);
    behind_ns_ -= back_ns;
    return -(back_ns + period_ns / 1000);
  }

 private:
  /// By how much the releases are later than they might be: a period at most, or a feeder that was slow
  /// for long could then be fast for long. Before the first one it is any time.
  std::int64_t behind_ns_ = INT64_MAX / 4;
};

class Feeds {
 public:
  struct Feed {
    std::size_t topic;
    detail::Inlet* inlet;
    Pace pace;
  };
  /// Its thread has SCHED_FIFO priority `fifo`; 0: an ordinary one. All outlive it. kUnavailable: there
  /// is none.
  [[nodiscard]] static Result<std::unique_ptr<Feeds>> start(Interop& interop,
                                                            std::vector<Feed> feeds, int fifo);
  ~Feeds();
  Feeds(const Feeds&) = delete;
  Feeds& operator=(const Feeds&) = delete;

 private:
  Feeds(Interop& interop, std::vector<Feed> feeds) : interop_(interop), feeds_(std::move(feeds)) {}
  void run();

  Interop& interop_;
  std::vector<Feed> feeds_;  ///< of the thread
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace xauto::runtime

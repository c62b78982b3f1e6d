// SPDX-License-Identifier: Apache-2.0
// ROS 2's executors, played: what an app did before XAuto, or would do under another executor.
//
//   Each callback runs to its end. What is ready is looked at in a wait set: all callbacks that are ready then and whose
//   group is free, timers before subscriptions. The executor runs these one after the other, and looks again when none
//   of them is left that may run: what becomes ready meanwhile waits, however urgent. The static one has subscriptions
//   before timers. A multi-threaded one does so with several threads, which share what the last look has found; of a
//   mutually exclusive group one callback runs at a time. The events executor has a queue, in the order in which things
//   became ready. A timer that was called too late skips the periods that have passed; a subscription whose queue is
//   full loses its oldest message.
//
// After rclcpp's Executor::get_next_executable, wait_for_work, MultiThreadedExecutor::run, StaticSingleThreadedExecutor
// and EventsExecutor, and rcl_timer_call (ROS 2 Humble to Jazzy).
#pragma once

#include <cstdint>
#include <vector>

#include "model/imported.h"
#include "model/reaction.h"

namespace xauto::solver {

struct ExecutedRun {
  std::vector<RanJob> jobs;                         ///< in the order of their starts
  std::vector<std::vector<std::int64_t>> releases;  ///< [source] nominal, in ns
  std::vector<double> busy;                         ///< [executor] part of its threads' time
  std::int64_t lost = 0;                            ///< messages that a full queue has lost
  std::int64_t skipped = 0;  ///< releases of timers that were called too late
  bool gave_up = false;      ///< there were more jobs than kMaxExecuted
};

inline constexpr std::size_t kMaxExecuted = 2'000'000;

/// For as long as the trace lasted, with the times that each callback took there, in their order and then from the first
/// on. Sources of other clocks than main begin at their offsets too; jitter of theirs is drawn by a fixed seed. All
/// executors together run so many callbacks at once as there were cores.
[[nodiscard]] ExecutedRun play_executors(const ImportedApp& imported);

}  // namespace xauto::solver

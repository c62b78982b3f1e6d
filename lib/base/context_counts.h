// SPDX-License-Identifier: Apache-2.0
// What cannot be promised of the contexts behind scheduling handles: counted by the backends of all
// processes of a run, on the board, and told by report and status.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

namespace xauto {

struct ContextCounts {
  std::atomic<std::uint32_t> incomplete{};  ///< now: a stage has not run yet, so more may be opened
  std::atomic<std::uint32_t> partial{};     ///< suspensions that may have left out what was new
  std::atomic<std::uint32_t> unclaimed{};   ///< TSGs and DLA queues of which nobody knows whose
  std::atomic<std::uint32_t> assumed{};     ///< contexts that were given what was nobody's
  std::atomic<std::uint32_t> shared{};      ///< contexts whose queue is another's, too
  std::atomic<std::uint32_t> gated{};       ///< contexts that are preempted no more
  std::atomic<std::uint32_t> held_up{};     ///< jobs that, suspended, held up a more urgent one
  std::atomic<std::uint32_t> misplaced{};   ///< jobs that could not be put on their level

  /// Why no worst case holds, a line each, for people. `live`: of a run that goes on.
  [[nodiscard]] std::vector<std::string> doubts(bool live) const {
    std::vector<std::string> lines;
    const auto say = [&](const std::atomic<std::uint32_t>& count, const char* what) {
      if (const std::uint32_t n = count.load(std::memory_order_relaxed); n > 0)
        lines.push_back(std::to_string(n) + " " + what);
    };
    if (live) say(incomplete, "contexts not complete: a stage on them has not run once");
    say(partial, "suspensions of a context may have left out what it had just opened");
    say(unclaimed, "TSGs or DLA queues are no known context's: they are not suspended");
    say(assumed, "contexts were made before `init`: that there was no other then is assumed");
    say(shared, "contexts are two modules', or their queue is: they are not suspended");
    say(gated, "GPU contexts did not leave the engine in time: they are not preempted any more");
    say(held_up, "suspended jobs held up a more urgent one that waits for their work");
    say(misplaced, "jobs ran on another priority level of the hardware than was theirs");
    return lines;
  }
};

}  // namespace xauto

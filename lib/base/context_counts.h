// SPDX-License-Identifier: Apache-2.0
// What cannot be promised of the contexts behind scheduling handles: counted by the backends of all
// processes of a run, on the board, and told by report and status.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

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

  /// `say(kind, count, what)` of each that only grows: why no worst case holds.
  template <class Say>
  void each(Say say) const {
    const auto tell = [&](const char* kind, const std::atomic<std::uint32_t>& count,
                          const char* what) {
      say(kind, count.load(std::memory_order_relaxed), what);
    };
    tell("partial_context", partial,
         "suspensions of a context may have left out what it had just opened");
    tell("unclaimed_queue", unclaimed,
         "TSGs or DLA queues are no known context's: they are not suspended");
    tell("assumed_context", assumed,
         "contexts were made before `init`: that there was no other then is assumed");
    tell("shared_context", shared,
         "contexts are two modules', or their queue is: they are not suspended");
    tell("gated_context", gated,
         "GPU contexts did not leave the engine in time: they are not preempted any more");
    tell("held_up_job", held_up,
         "suspended jobs held up a more urgent one that waits for their work");
    tell("misplaced_job", misplaced,
         "jobs ran on another priority level of the hardware than was theirs");
  }
  /// ... that counts now: a stage has not run once, so its context may not be complete.
  [[nodiscard]] std::string not_complete() const {
    const std::uint32_t n = incomplete.load(std::memory_order_relaxed);
    if (n == 0) return {};
    return std::to_string(n) + " contexts not complete: a stage on them has not run once";
  }
};

}  // namespace xauto

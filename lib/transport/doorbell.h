// SPDX-License-Identifier: Apache-2.0
// The doorbell of one process: "look into your queues". In memory shared between processes; no
// system call while its owner is awake.
#pragma once

#include <atomic>
#include <cstdint>

#include "base/clock.h"
#include "base/futex.h"

namespace xauto::transport {

struct alignas(64) Doorbell {
  std::atomic<std::uint32_t> rings{};    ///< [*] a futex
  std::atomic<std::uint32_t> waiting{};  ///< [*] 1: the owner sleeps, or is about to

  void ring() {
    rings.fetch_add(1, std::memory_order_seq_cst);
    if (waiting.load(std::memory_order_seq_cst) != 0 &&
        waiting.exchange(0, std::memory_order_seq_cst) != 0)
      futex_wake(rings, 1);
  }
  /// One thread. `nothing_to_do` is asked after the announcement, so that no ring is missed.
  template <class NothingToDo>
  void wait(NothingToDo nothing_to_do, std::int64_t limit_ns = kLookNs) {
    const std::uint32_t seen = rings.load(std::memory_order_seq_cst);
    waiting.store(1, std::memory_order_seq_cst);
    if (nothing_to_do()) futex_wait(rings, seen, limit_ns);
    waiting.store(0, std::memory_order_seq_cst);
  }
};
static_assert(sizeof(Doorbell) == 64);

}  // namespace xauto::transport

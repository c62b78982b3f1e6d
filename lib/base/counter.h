// SPDX-License-Identifier: Apache-2.0
// Counters that any thread reads: one to which one thread at a time adds (an owner, or whoever holds a lock),
// and the largest value seen, of any thread.
#pragma once

#include <atomic>

namespace xauto {

/// No locked access: on a hot path each of them costs as much as some ten instructions.
template <class T>
void add_alone(std::atomic<T>& counter, T value = 1) {
  counter.store(counter.load(std::memory_order_relaxed) + value, std::memory_order_relaxed);
}

template <class T>
void keep_largest(std::atomic<T>& largest, T value) {
  T seen = largest.load(std::memory_order_relaxed);
  while (value > seen && !largest.compare_exchange_weak(seen, value)) {
  }
}

}  // namespace xauto

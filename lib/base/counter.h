// SPDX-License-Identifier: Apache-2.0
// A counter that any thread reads and one at a time adds to (an owner, or whoever holds a lock).
#pragma once

#include <atomic>

namespace xauto {

/// No locked access: on a hot path each of them costs as much as some ten instructions.
template <class T>
void add_alone(std::atomic<T>& counter, T value = 1) {
  counter.store(counter.load(std::memory_order_relaxed) + value, std::memory_order_relaxed);
}

}  // namespace xauto

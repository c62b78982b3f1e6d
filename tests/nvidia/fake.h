// SPDX-License-Identifier: Apache-2.0
// CUDA, acted out on the CPU: what a stream is given runs when somebody waits for the stream, as late as it may on a
// GPU. So a wait that is missing, or a copy in the wrong order, gives wrong numbers.
#pragma once

#include <functional>

#include "cuda.h"

namespace fake {

/// Contexts, streams and memory that were made and are not gone yet.
struct Alive {
  int contexts = 0, memory = 0;
};
Alive alive();
/// The calling thread's current context; null: none.
CUcontext current();
/// Queues work; false if `stream` is none of the current context's.
bool enqueue(CUstream stream, std::function<void()> work);
/// Whether all of it is memory of ours, in the context that is current.
bool is_memory(const void* address, std::size_t bytes);
/// From now on this call of cuMemHostAlloc fails, the first one being 0; -1: none.
void fail_allocation(int number);

}  // namespace fake

// SPDX-License-Identifier: Apache-2.0
// CUDA, acted out on the CPU: what a stream is given runs when somebody waits for a stream, as late as it may on a GPU.
// So a wait that is missing, or a copy in the wrong order, gives wrong numbers.
//
// A GPU runs one block at a time here, to its end; then the next one of the stream with the greatest priority that has
// any ("pending work in a higher-priority stream takes preference": CUDA's guide, stream priorities). Whoever waits for
// a stream lends its thread to the blocks that are next, also to those of others. Any thread.
#pragma once

#include <functional>

#include "cuda.h"

namespace fake {

/// Contexts, streams and memory that were made and are not gone yet.
struct Alive {
  int contexts = 0, streams = 0, graphs = 0, memory = 0;
};
Alive alive();
/// The calling thread's current context; null: none.
CUcontext current();
/// Queues a block; false if `stream` is none of the current context's.
bool enqueue(CUstream stream, std::function<void()> block);
/// Whether all of it is memory of ours, in the context that is current.
bool is_memory(const void* address, std::size_t bytes);
/// From now on this call of cuMemHostAlloc fails, the first one being 0; -1: none.
void fail_allocation(int number);
/// How many stream priorities the GPU has from now on: 0 and below.
void set_priorities(int count);
/// Blocks that wait on any stream.
std::size_t queued();
/// 0 is the least.
int priority_of(CUstream stream);

}  // namespace fake

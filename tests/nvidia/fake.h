// SPDX-License-Identifier: Apache-2.0
// CUDA, acted out on the CPU: what a stream is given runs when somebody waits for a stream, as late as it may on a GPU.
// So a wait that is missing, or a copy in the wrong order, gives wrong numbers.
//
// A GPU runs one block at a time here, to its end; then the next one of the stream with the greatest priority that has
// any ("pending work in a higher-priority stream takes preference": CUDA's guide, stream priorities). Whoever waits for
// a stream lends its thread to the blocks that are next, also to those of others. A Device has threads of its own, for
// several blocks at a time. Any thread.
#pragma once

#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

#include "cuda.h"

namespace fake {

/// Contexts, streams and memory that were made and are not gone yet.
struct Alive {
  int contexts = 0, streams = 0, graphs = 0, memory = 0;
};
Alive alive();
/// The calling thread's current context; null: none.
CUcontext current();
/// Queues a kernel of so many blocks, which begins when what is before it on the stream has ended; false if `stream` is
/// none of the current context's.
bool enqueue(CUstream stream, std::function<void()> block, int blocks = 1);
/// From when a stream got its first work to when it had none any more; CLOCK_MONOTONIC, ns.
struct Busy {
  std::int64_t since_ns = 0, until_ns = 0;
  int met = 0;    ///< blocks of others that ran when it got that
  int waits = 0;  ///< kernels that a block of another stream was in the way of
};
/// The last time.
Busy last_busy(CUstream stream);
/// While it lives, the GPU runs so many blocks at a time: those of the greatest priority first, and where these leave
/// room, others beside them. When a kernel has ended, blocks of others may come before the next one of its stream: the
/// guide does not say that none does, and here one always does. Contexts take turns, a block each. One at a time.
class Device {
 public:
  explicit Device(int units);
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  ~Device();

 private:
  std::vector<std::thread> units_;
};
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

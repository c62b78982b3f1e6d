// SPDX-License-Identifier: Apache-2.0
// What libxauto_watch.so has seen of this process: it stands before libc's ioctl, by LD_PRELOAD or
// because the program is linked with it, and reads what drivers tell that no descriptor shows: the
// channels of NVIDIA's RM, the queues of amdkfd, the contexts of i915. Plain C: the library that asks finds these by name
// (kernel/watched.h), and may be another build.
#pragma once

#include <cstddef>
#include <cstdint>

extern "C" {

/// A channel of NVIDIA's RM. Handles are numbers within `client`.
struct xauto_watched_channel {
  std::int32_t fd;  ///< /dev/nvidiactl, through which `client` was made: it answers there alone
  std::uint32_t client;
  std::uint32_t subdevice;  ///< of the same device
  std::uint32_t group;      ///< its channel group; its own handle where it has none
  std::uint32_t channel;
  std::uint32_t made;  ///< its group was the so manieth object: handles are used again
};

/// A queue of amdkfd's, with what UPDATE_QUEUE must be told again.
struct xauto_watched_kfd_queue {
  std::int32_t fd;  ///< /dev/kfd
  std::uint32_t queue;
  std::uint64_t ring_address, ring_size;
  std::uint32_t percentage, priority;  ///< that the process asked for last
  std::uint32_t updates;               ///< how often it has
  std::uint32_t made;                  ///< it was the so manieth: numbers are used again
};

/// A context of i915's.
struct xauto_watched_i915_context {
  std::int32_t fd;  ///< of the node, whose file it is of
  std::uint32_t context;
  std::uint32_t made;  ///< it was the so manieth: numbers are used again
  char node[36];       ///< "/dev/dri/renderD128"
};

/// The first `room` of them; how many there are.
std::size_t xauto_watched_channels_1(xauto_watched_channel* to, std::size_t room);
/// The driver knows no such client on its descriptor: that was closed, and nobody is told of that.
void xauto_watched_client_is_gone_1(std::uint32_t client);
std::size_t xauto_watched_kfd_queues_1(xauto_watched_kfd_queue* to, std::size_t room);
std::size_t xauto_watched_i915_contexts_1(xauto_watched_i915_context* to, std::size_t room);

}  // extern "C"

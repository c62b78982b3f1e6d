// SPDX-License-Identifier: Apache-2.0
// The part of amdkfd's interface that XAuto speaks and listens to, written from Linux's
// include/uapi/linux/kfd_ioctl.h, which needs headers of libdrm: /dev/kfd, ioctls of type 'K'.
#pragma once

#include <cstddef>
#include <cstdint>

#include <linux/ioctl.h>

namespace xauto::kernel::kfd {

constexpr const char* kNode = "/dev/kfd";
inline constexpr char kType = 'K';

/// The driver takes a longer or shorter argument, too: later headers have added at its end.
struct CreateQueue {
  std::uint64_t ring_address, write_address, read_address, doorbell;
  std::uint32_t ring_size, gpu, type, percentage, priority, queue;
};
static_assert(offsetof(CreateQueue, queue) == 52);

struct DestroyQueue {
  std::uint32_t queue, padding;
};
static_assert(sizeof(DestroyQueue) == 8);

struct UpdateQueue {
  std::uint64_t ring_address;
  std::uint32_t queue, ring_size, percentage, priority;
};
static_assert(sizeof(UpdateQueue) == 24);

inline constexpr unsigned kCreateQueue = 0x02, kDestroyQueue = 0x03, kUpdateQueue = 0x07;
inline constexpr unsigned long kUpdateQueueCall = _IOW(kType, kUpdateQueue, UpdateQueue);

}  // namespace xauto::kernel::kfd

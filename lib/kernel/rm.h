// SPDX-License-Identifier: Apache-2.0
// The part of NVIDIA's RM interface that XAuto speaks and listens to, written from its description
// (open-gpu-kernel-modules 595.45.04, the same since 515): /dev/nvidiactl, ioctls of type 'F' whose
// number is the escape and whose argument carries handles and a status of its own.
#pragma once

#include <cstddef>
#include <cstdint>

namespace xauto::kernel::rm {

constexpr const char* kControlNode = "/dev/nvidiactl";

/// _IOWR('F', number, size)
constexpr unsigned long escape(unsigned number, std::size_t size) {
  return 3ul << 30 | static_cast<unsigned long>(size) << 16 | 'F' << 8 | number;
}
inline constexpr unsigned kFree = 0x29, kControl = 0x2a, kAlloc = 0x2b;
/// The same, where the size does not fit an ioctl's number, or the caller likes.
inline constexpr unsigned kTransfer = 211;

struct Free {
  std::uint32_t root, parent, object, status;
};
static_assert(sizeof(Free) == 16);

struct Control {
  std::uint32_t client, object, command, flags;
  std::uint64_t params;
  std::uint32_t params_size, status;
};
static_assert(sizeof(Control) == 32);

struct Alloc {
  std::uint32_t root, parent, object, type;
  std::uint64_t params;
  std::uint32_t params_size, status;
};
static_assert(sizeof(Alloc) == 32);

/// Alloc with access rights; told apart by its size.
struct AllocWithRights {
  std::uint32_t root, parent, object, type;
  std::uint64_t params, rights;
  std::uint32_t params_size, flags, status, padding;
};
static_assert(sizeof(AllocWithRights) == 48);

struct Transfer {
  std::uint32_t command, size;
  std::uint64_t argument;
};
static_assert(sizeof(Transfer) == 16);

// Types of objects.
inline constexpr std::uint32_t kRoot = 0x0, kRootNonPrivileged = 0x1, kRootClient = 0x41;
inline constexpr std::uint32_t kDevice = 0x80, kSubdevice = 0x2080, kChannelGroup = 0xa06c;
/// Every architecture has a type of channel: 0xa06f (Kepler) to 0xca6f (Blackwell).
constexpr bool is_channel(std::uint32_t type) {
  return (type & 0xffff00ff) == 0x6f && type >= 0xa06f;
}

/// Of a subdevice. "The call will ensure none of the listed channels are running in hardware and
/// will not run until a call with disable = false": it holds, unlike nvgpu's DISABLE. The answer is
/// the GSP firmware's.
inline constexpr std::uint32_t kDisableChannels = 0x2080110b;
inline constexpr std::size_t kMaxChannels = 64;
struct DisableChannels {
  std::uint8_t disable;
  std::uint8_t pad0[3];
  std::uint32_t count;
  std::uint8_t only_scheduling;  ///< not preempted
  std::uint8_t rewind_put;
  std::uint8_t pad1[6];
  std::uint64_t preempt_event;  ///< kernel clients only; 0: it waits
  std::uint32_t clients[kMaxChannels], channels[kMaxChannels];
};
static_assert(offsetof(DisableChannels, count) == 4);
static_assert(offsetof(DisableChannels, only_scheduling) == 8);
static_assert(offsetof(DisableChannels, preempt_event) == 16);
static_assert(offsetof(DisableChannels, clients) == 24);
static_assert(sizeof(DisableChannels) == 536);

// Statuses.
inline constexpr std::uint32_t kOk = 0, kBusyRetry = 0x3, kGpuIsLost = 0xf, kInvalidClient = 0x23,
                               kInvalidObjectHandle = 0x33, kInvalidArgument = 0x1f,
                               kNotSupported = 0x56, kObjectNotFound = 0x57, kStateInUse = 0x63,
                               kTimeout = 0x65, kTimeoutRetry = 0x66;

}  // namespace xauto::kernel::rm

// SPDX-License-Identifier: Apache-2.0
// The part of i915's interface that XAuto speaks and listens to, written from Linux's
// include/uapi/drm/i915_drm.h and drm.h, which need headers of libdrm: ioctls of type 'd' on the
// nodes under /dev/dri, which other drivers have too.
#pragma once

#include <cstdint>
#include <string_view>

#include <linux/ioctl.h>

namespace xauto::kernel::i915 {

inline constexpr const char* kFolder = "/dev/dri/";
inline constexpr int kFirstRender = 128, kRenders = 64;  ///< renderD128 and up
inline constexpr std::string_view kDriver = "i915";      ///< what VERSION says
inline constexpr char kType = 'd';

struct Version {
  std::int32_t major, minor, patch;
  std::uint64_t name_size;
  char* name;
  std::uint64_t date_size;
  char* date;
  std::uint64_t text_size;
  char* text;
};
static_assert(sizeof(void*) != 8 || sizeof(Version) == 64);

struct Get {
  std::int32_t what;
  std::int32_t* value;
};
static_assert(sizeof(void*) != 8 || sizeof(Get) == 16);

/// The driver takes a longer argument, too: flags and extensions.
struct Context {
  std::uint32_t id, padding;
};
static_assert(sizeof(Context) == 8);

struct Parameter {
  std::uint32_t context, size;
  std::uint64_t parameter, value;
};
static_assert(sizeof(Parameter) == 24);

inline constexpr unsigned kCreate = 0x6d, kDestroy = 0x6e;
inline constexpr unsigned long kVersionCall = _IOWR(kType, 0x00, Version),
                               kGetCall = _IOWR(kType, 0x46, Get),
                               kCreateCall = _IOWR(kType, kCreate, Context),
                               kDestroyCall = _IOW(kType, kDestroy, Context),
                               kGetParameterCall = _IOWR(kType, 0x74, Parameter),
                               kSetParameterCall = _IOWR(kType, 0x75, Parameter);

inline constexpr std::int32_t kHasScheduler = 41;
inline constexpr std::int32_t kPriorities = 1 << 1, kPreemption = 1 << 2, kThreeBuckets = 1 << 5;
inline constexpr std::uint64_t kPriority = 6;
/// Above 0 needs CAP_SYS_NICE.
inline constexpr int kLeastPriority = -1023;

/// Whether it is this driver's; `call` is an ioctl.
template <class Call>
[[nodiscard]] bool is_i915(int fd, const Call& call) {
  char name[8] = {};
  Version version{};
  version.name = name;
  version.name_size = sizeof name;
  return call(fd, kVersionCall, &version) == 0 && version.name_size == kDriver.size() &&
         std::string_view(name, kDriver.size()) == kDriver;
}

}  // namespace xauto::kernel::i915

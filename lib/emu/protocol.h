// SPDX-License-Identifier: Apache-2.0
// Packets between an emulated context's user and xauto-emud (abstract AF_UNIX, SOCK_SEQPACKET). One
// fixed layout for all; unused fields are zero and checked.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace xauto::emu {

inline constexpr std::uint32_t kEmuVersion = 3;
inline constexpr std::size_t kMaxDeviceName = 48;
inline constexpr const char* kEmudVariable = "XAUTO_EMUD";  ///< abstract socket of this session
inline constexpr const char* kCpuPoolVariable =
    "XAUTO_EMU_CPU_POOL";  ///< "1": CPU contexts on the pool

/// Ids of XPUs of this run, each with a line end behind it: of those that are real, and of those
/// whose contexts are on the emulator modules' nodes.
inline constexpr const char* kRealVariable = "XAUTO_REAL";
inline constexpr const char* kDriversVariable = "XAUTO_EMU_DRIVERS";

enum class Op : std::uint32_t {
  kOpen = 1,     ///< name, value = version -> kOpened
  kSubmit = 2,   ///< context, tag, value = ns of work -> kDone when finished
  kSuspend = 3,  ///< context (anybody's of this session), tag -> kSuspended
  kResume = 4,   ///< context, tag -> kResumed
  kRejoin = 5,   ///< to the next emulator: context, value = its key, tag of the call under way (0:
                 ///< none) -> kRejoined
  kPing = 6,     ///< tag -> kPong: the tool asks whether the emulator still answers
  kLevel = 7,    ///< context, tag, value = level of what it is given from now on -> kLeveled
  kBusy = 8,     ///< tag, name -> kBusied: how long the device has been busy
  kOpened = 65,  ///< context, value = the key that has it back
  kDone = 66,
  kSuspended = 67,
  kResumed = 68,
  kError = 69,     ///< tag of the request, value = ErrorCode, name = text
  kRejoined = 70,  ///< context, tag, value = Progress of the call: kUnknown -> submit it again,
                   ///< kUnderWay -> kDone will come
  kPong = 71,
  kLeveled = 72,
  kBusied = 73,  ///< tag, value = ns
};

struct Packet {
  std::uint32_t op = 0;
  std::uint32_t context = 0;
  std::uint64_t tag = 0;
  std::int64_t value = 0;
  char name[kMaxDeviceName] = {};  ///< NUL-terminated
};
static_assert(sizeof(Packet) == 72 && std::is_trivially_copyable_v<Packet>);

}  // namespace xauto::emu

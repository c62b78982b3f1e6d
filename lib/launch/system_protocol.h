// SPDX-License-Identifier: Apache-2.0
// What is said at the machine's socket (AF_UNIX, SOCK_SEQPACKET, a path). Who connects says one of
//   Join, then its demand in pieces (of a run that is not trusted: its LeaseTasks)   a run: answered with Admitted or NotAdmitted. The connection is its lease:
//                                     where it ends, the run has gone
//   coord::Attach                     a worker of such a run: the connection goes on to the coordinator
//   MessageKind::kStatus alone        anybody: answered with JSON text
//   SystemWord::kWatch alone          whose runs are trusted: answered with JSON text, and for each of its `xpus` a record
//                                     (coord/record.h) that can only be read
// No descriptor is taken from anybody: to close one may wait for a stranger.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "coord/protocol.h"

namespace xauto::launch {

inline constexpr std::uint32_t kSystemVersion = 3;
inline constexpr const char* kSystemSocket = "/run/xauto/coordinator.sock";
inline constexpr std::size_t kMaxLeaseXpus = 64;
inline constexpr std::size_t kMaxLeaseName = 64;
inline constexpr std::size_t kDemandPiece = 32 * 1024;  ///< of all packets but the last
inline constexpr std::size_t kMaxDemandBytes = 8u << 20;

enum class SystemWord : std::uint32_t {
  kJoin = 0x10,
  kAdmitted = 0x11,
  kNotAdmitted = 0x12,
  kWatch = 0x13,
};

struct JoinXpu {
  char id[kMaxLeaseName] = {};                  ///< of the platform that the demand is of, "cpu0"
  char hardware[coord::kMaxHardwareName] = {};  ///< what that is on this machine, "core3"
  char type[16] = {};                           ///< "cpu", "gpu"; cut off
  std::int32_t instance = 0;                    ///< of that type
  std::uint32_t pad = 0;
  std::uint32_t discipline = 0;  ///< xauto::Discipline
  std::int32_t levels = 0;       ///< of Discipline::kLevels
  std::int64_t preempt_us = 0;   ///< as its platform says
};

/// An XNode of a run that is not trusted. The XNode's number is the app's.
struct LeaseTask {
  std::uint32_t xpu = 0;  ///< index into Join::xpus
  std::uint32_t pad = 0;
  coord::SporadicTask task;
};

struct Join {
  std::uint32_t kind = static_cast<std::uint32_t>(SystemWord::kJoin);
  std::uint32_t version = kSystemVersion;
  char app[kMaxLeaseName] = {};
  std::uint32_t num_xnodes = 0;
  std::uint32_t num_xpus = 0;
  std::uint32_t demand_bytes = 0;
  std::uint32_t num_tasks = 0;  ///< above 0: LeaseTasks come in place of a demand
  JoinXpu xpus[kMaxLeaseXpus] = {};
};

struct Admitted {
  std::uint32_t kind = static_cast<std::uint32_t>(SystemWord::kAdmitted);
  std::uint32_t lease = 0;
  std::uint64_t secret = 0;
  std::uint32_t first_xnode = 0;
  std::uint32_t num_xnodes = 0;
};

struct NotAdmitted {
  std::uint32_t kind = static_cast<std::uint32_t>(SystemWord::kNotAdmitted);
  std::uint32_t later =
      0;  ///< 1: only what those have not given back yet that have left is in the way
  char reason[1016] = {};
};

static_assert(std::is_trivially_copyable_v<Join> &&
              sizeof(Join) == 88 + kMaxLeaseXpus * sizeof(JoinXpu));
static_assert(std::is_trivially_copyable_v<LeaseTask> && sizeof(LeaseTask) == 48);
static_assert(std::is_trivially_copyable_v<Admitted> && sizeof(Admitted) == 24);
static_assert(std::is_trivially_copyable_v<NotAdmitted> && sizeof(NotAdmitted) == 1024);

}  // namespace xauto::launch

// SPDX-License-Identifier: Apache-2.0
// What travels over a coordinator's socket (abstract AF_UNIX, SOCK_SEQPACKET, one packet per
// message): registration, with the shared memory's descriptors in the answer, and status. The
// socket's end is how each side learns of the other's death. Everything on the job path is in
// shm_layout.h instead.
//
// A coordinator that several runs share listens nowhere: the machine's service hands each connection to it, with
// Adopt, over a socket that the two have (launch/system_service.h). From then on it is a connection like others.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "coord/regulator.h"

namespace xauto::coord {

inline constexpr std::uint32_t kProtocolVersion = 8;
inline constexpr std::size_t kMaxWorkerName = 64;
inline constexpr std::size_t kMaxWorkerXNodes = 256;
inline constexpr std::size_t kMaxStatusBytes = 64 * 1024;
inline constexpr std::size_t kMaxHardwareName = 32;

enum class MessageKind : std::uint32_t {
  kHello = 1,  ///< worker -> coordinator: Hello
  kWelcome =
      2,  ///< coordinator -> worker: Welcome + {memfd, doorbell eventfd}; {.., record.h} of a shared one
  kRefused = 3,  ///< coordinator -> worker: Refused, then the socket is closed
  kStatus = 4,   ///< anybody -> coordinator: MessageKind alone; answered with JSON text
  kObserve = 5,  ///< worker -> coordinator: MessageKind alone; answered with Welcome + {memfd}
  kAttach =
      6,  ///< worker -> service: Attach, before all else; Refused, or what the coordinator answers to the rest
  kAdopt = 7,     ///< service -> coordinator: Adopt + {connection}
  kEndLease = 8,  ///< service -> coordinator: Adopt, without a connection: the run is gone
  kRegulate = 9,  ///< service -> coordinator: Regulate, before the first Adopt of that lease
};

struct Attach {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kAttach);
  std::uint32_t version = kProtocolVersion;
  std::uint32_t lease = 0;
  std::uint32_t pad = 0;
  std::uint64_t secret = 0;
  char hardware[kMaxHardwareName] = {};  ///< NUL-terminated
};

/// Whose connection it is: a worker behind it may name these XNodes, and no others.
struct Adopt {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kAdopt);
  std::uint32_t lease = 0;
  std::uint32_t first_xnode = 0, num_xnodes = 0;
  /// 1: the run is not trusted. A coordinator that has not heard what it may have closes the connection: it has begun
  /// again since.
  std::uint32_t regulated = 0;
};

inline constexpr std::size_t kMaxRegulated = 256;  ///< XNodes of one run

/// The run is not trusted: it shares no memory with others, and has of this XPU what these say.
struct Regulate {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kRegulate);
  std::uint32_t lease = 0;
  std::uint32_t hostile = 0;  ///< 1: not even its threads, which are another user's
  std::uint32_t num_tasks = 0;
  SporadicTask tasks[kMaxRegulated] = {};
};

struct Hello {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kHello);
  std::uint32_t version = kProtocolVersion;
  char worker[kMaxWorkerName] = {};  ///< NUL-terminated, for people
  std::uint32_t rejoin = 0;          ///< slot + 1 that it had with a coordinator that died; 0: none
  /// Order pairs on this XPU that its app keeps: all that the coordinator knows, or none. The app
  /// knows its sources' rates, the coordinator does not.
  std::uint32_t num_order = 0;
  std::uint32_t num_xnodes = 0;
  std::uint32_t xnodes[kMaxWorkerXNodes] = {};  ///< whose jobs this worker will bring
};

struct Welcome {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kWelcome);
  std::uint32_t slot = 0;  ///< of the answer to kObserve: nobody's
};

struct Refused {
  std::uint32_t kind = static_cast<std::uint32_t>(MessageKind::kRefused);
  char reason[124] = {};
};

static_assert(std::is_trivially_copyable_v<Hello> && sizeof(Hello) == 84 + 4 * kMaxWorkerXNodes);
static_assert(std::is_trivially_copyable_v<Welcome> && sizeof(Welcome) == 8);
static_assert(std::is_trivially_copyable_v<Attach> && sizeof(Attach) == 24 + kMaxHardwareName);
static_assert(std::is_trivially_copyable_v<Adopt> && sizeof(Adopt) == 20);
static_assert(std::is_trivially_copyable_v<Regulate> &&
              sizeof(Regulate) == 16 + kMaxRegulated * sizeof(SporadicTask));
static_assert(std::is_trivially_copyable_v<Refused> && sizeof(Refused) == 128);

}  // namespace xauto::coord

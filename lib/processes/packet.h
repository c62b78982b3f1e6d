// SPDX-License-Identifier: Apache-2.0
// An app in several processes, all of the same program: process 0, the hub, has the sources, the
// observers, the accounts, and the modules that nobody isolated; each other process, a member, has
// the modules that the session gives it. Topics that leave a process are in shared memory
// (transport/shm_topic.h); all else goes over a socket between hub and member, whose end is how
// each learns of the other's death.
//
//   member: Hello ──► hub                         when the member's process has started
//           ◄── Topic*, Board, Begin              descriptors of what it reads and publishes
//           Ready ──►                             its modules' init is done
//           ◄── Go                                from here on it reads its queues
//           Event* ──►                            a sink module is through with a release
//           ◄── Stop,  Report ──►                 the end: what it has to tell
//
// While a member is dead the hub stands in for its modules: every release that comes to them is
// lost, and told so downstream (StandIn). A member that is started again takes over at Go, where
// the hub left off; its modules begin with a new state.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <xauto/result.h>

#include "model/message.h"

namespace xauto::runtime {

enum class Word : std::uint32_t {
  kHello = 1,
  kTopic,
  kBoard,
  kBegin,
  kReady,
  kGo,
  kEvent,
  kStop,
  kReport,
  kGone,  ///< supervisor -> hub: this process will not come (back)
};

struct Packet {
  std::uint32_t word = 0;
  std::uint32_t index = 0;  ///< process, topic, or module
  std::uint64_t sequence = 0;
  std::int64_t origin_ns = 0, now_ns = 0;
  std::uint32_t lost = 0;
  std::uint32_t rates = 0;   ///< 1: `origins` is filled in
  std::uint32_t urgent = 0;  ///< 1: of a release that its sensor marked
  std::uint32_t pad = 0;
  detail::Origins origins{};  ///< by source, see Envelope
};
static_assert(sizeof(Packet) == 48 + sizeof(detail::Origins));
inline constexpr std::size_t kMaxReportBytes = 32 * 1024;

/// Sends a word without more; errors are the socket's.
[[nodiscard]] Status say(int socket, Word word, int index = 0, const std::vector<int>& fds = {});

}  // namespace xauto::runtime

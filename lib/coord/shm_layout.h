// SPDX-License-Identifier: Apache-2.0
// The memory that the workers of one XPU and its coordinator share. A memfd made by the coordinator
// and handed to each worker over its socket; when the last of them is gone, so is the memory.
//
//   ┌ Header ┬ slots[kMaxSlots] ┬ finished[num_xnodes] ┐
//
// State is level-triggered: the coordinator recomputes from the words; a ring of the doorbell only
// says "look". No lock is shared; a client that dies or misbehaves holds up nothing but its own
// job.
//
// The owner word makes uncontended START and FINISH one atomic each, without waking anybody:
//
//        0 ──START: CAS──► {slot, generation} ──FINISH: CAS──► 0          "thin": nobody else is
//        there │                        │ └──── START that finds it taken, or is not eligible: sets
//        kContended, rings ────┐
//                                 ▼                                                      ▼
//                            kContended            "fat": every START and FINISH rings; the
//                            coordinator
//                                 │                 adopts the thin owner and decides with the
//                                 arbiter └─ nobody has a job left: coordinator CAS ──► 0
//
// A START writes its request before it looks at the owner word, and always rings after it has seen
// or set kContended; the coordinator scans all requests after each ring. Hence no START is lost,
// whichever way the words are interleaved (tests/unit/coord explores them).
//
// Who writes: [W] the worker of the slot, [C] the coordinator, [*] both, by the protocol above.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "coord/arbiter.h"

namespace xauto::coord {

inline constexpr std::uint32_t kShmMagic = 0x58434f52;  // "XCOR"
inline constexpr std::uint32_t kShmVersion = 1;

/// Owner word: bit 63 contended, bits 40..47 slot + 1 (0: nobody), bits 0..31 generation.
inline constexpr std::uint64_t kContended = 1ull << 63;
constexpr std::uint64_t owner_word(int slot, std::uint32_t generation) {
  return (static_cast<std::uint64_t>(slot) + 1) << 40 | generation;
}
constexpr int owner_slot(std::uint64_t word) {
  return static_cast<int>(word >> 40 & 0xff) - 1;
}
constexpr std::uint32_t owner_generation(std::uint64_t word) {
  return static_cast<std::uint32_t>(word);
}

/// Request word: bits 0..1 what the worker's job is doing, bits 2..31 its generation.
enum class Want : std::uint32_t {
  kIdle = 0,  ///< no job
  kRun = 1,   ///< has a job: running if it is the thin owner or was granted, waiting otherwise
  kRuns = 2,  ///< kernel-scheduled XPU: runs without asking
};
inline constexpr std::uint32_t kGenerationMask = (1u << 30) - 1;
constexpr std::uint32_t request_word(Want want, std::uint32_t generation) {
  return (generation & kGenerationMask) << 2 | static_cast<std::uint32_t>(want);
}
constexpr Want request_want(std::uint32_t word) {
  return static_cast<Want>(word & 3);
}
constexpr std::uint32_t request_generation(std::uint32_t word) {
  return word >> 2;
}

/// Command and acknowledgement: bit 0 the queue shall be suspended, bit 1 (ack only) that failed,
/// bits 2..31 count.
constexpr std::uint32_t command_word(bool suspend, std::uint32_t count) {
  return count << 2 | (suspend ? 1u : 0u);
}
inline constexpr std::uint32_t kAckFailed = 2;

struct alignas(64) WorkerLine {
  std::atomic<std::uint32_t> request{};  ///< [W]
  std::atomic<std::uint32_t> ack{};      ///< [W] management thread: last command carried out
  std::atomic<std::uint32_t> xnode{};    ///< [W] the job, written before `request`
  std::atomic<std::uint32_t> pad{};
  std::atomic<std::int64_t> priority{};   ///< [W]
  std::atomic<std::uint64_t> sequence{};  ///< [W]
  std::atomic<std::uint64_t>
      since_ns{};  ///< [W] CLOCK_MONOTONIC of the request; for `xauto status`
};
struct alignas(64) CoordinatorLine {
  std::atomic<std::uint32_t> grant{};    ///< [C] generation that may run; a futex
  std::atomic<std::uint32_t> command{};  ///< [C] for the management thread
};
struct SlotMemory {
  WorkerLine worker;
  CoordinatorLine coordinator;
};
static_assert(sizeof(SlotMemory) == 128);

struct alignas(64) Header {
  std::uint32_t magic = 0;
  std::uint32_t version = 0;
  std::uint32_t num_xnodes = 0;
  std::uint8_t discipline = 0;
  std::uint8_t pad[3] = {};
  alignas(64) std::atomic<std::uint64_t> owner{};  ///< [*]
  alignas(64) std::atomic<std::uint32_t> rings{};  ///< [*] counts rings of the doorbell
  std::atomic<std::uint32_t> waiting{};  ///< [*] 1: the coordinator sleeps, ring its eventfd
};
static_assert(sizeof(Header) == 192);

inline constexpr std::uint32_t kMaxSharedXNodes = 20'000;

/// Typed view of the mapping; the layout is the picture above.
struct Shm {
  Header* header = nullptr;
  SlotMemory* slots = nullptr;
  std::atomic<std::uint64_t>* finished = nullptr;  ///< [W] activations of the XNode that are over

  static constexpr std::size_t bytes(std::uint32_t num_xnodes) {
    return sizeof(Header) + kMaxSlots * sizeof(SlotMemory) + num_xnodes * sizeof(std::uint64_t);
  }
  static Shm at(void* memory) {
    Shm shm;
    shm.header = static_cast<Header*>(memory);
    shm.slots = reinterpret_cast<SlotMemory*>(shm.header + 1);
    shm.finished = reinterpret_cast<std::atomic<std::uint64_t>*>(shm.slots + kMaxSlots);
    return shm;
  }
};

static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
static_assert(std::atomic<std::uint32_t>::is_always_lock_free);

}  // namespace xauto::coord

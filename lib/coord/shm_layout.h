// SPDX-License-Identifier: Apache-2.0
// The memory that the workers of one XPU and its coordinator share. A memfd made by the coordinator
// and handed to each worker over its socket; when the last of them is gone, so is the memory.
//
//   ┌ Header ┬ slots[kMaxSlots] ┬ finished[num_xnodes] ┐
//
// State is level-triggered: the coordinator recomputes from the words; a ring of the doorbell only
// says "look". No lock is shared; a client that dies holds up nothing but its own job. The memory
// outlives the coordinator, and a new one rebuilds everything from it.
//
// The owner word: who has the XPU, and who decides. START and FINISH of a job that meets nobody are
// one atomic each; a job that is less urgent than the owner parks, and the owner's FINISH hands the
// XPU over to the most urgent that is parked: one wake-up, and no coordinator. A job that is more
// urgent takes the XPU: it commands the owner's management thread to suspend, and runs; its FINISH
// gives the XPU back. A job whose order predecessors have not finished parks, too. What is more than
// that, and a death, are the coordinator's.
//
//          START: CAS               START of a less urgent job: CAS, parks      (the count in the
//     0 ──────────────► {owner} ─────────────────────────► {owner, kParked}     word makes FINISH
//     ▲   FINISH: CAS      │                                   │        │       see every parking)
//     └────────────────────┤ ◄── FINISH, the last one parked ──┘ ◄──────┘ FINISH: {next, kParked}
//                          │
//                          │  more urgent START: CAS, command to suspend
//                          ├──────────────────────────────────────────────► {it, kTaken}
//                          │  FINISH, nobody parked is more urgent than the      │
//                          │  victim: CAS to {victim}, command to resume         │
//                          │ ◄───────────────────────────────────────────────────┤
//                          ▼                                                     ▼
//              a START or FINISH that may do none of these, a death: CAS to | kFat, rings
//                          │
//            {.., kFat}: the coordinator alone writes the word; every START and FINISH rings
//                          │ no queue is suspended or being suspended, one job at most is admitted
//                          └──► back to 0, {kParked}, {owner} or {owner, kParked}
//
// Order: {kParked} is 0 where all that are parked wait for their predecessors. A FINISH first says, in
// `finished`, that its XNode has ended, and then looks at the word; it hands over to the most urgent
// that is eligible. A START that is not eligible parks, and then looks once more whether it is. So
// one of the two sees the other. A release that is lost says so, too: whom that makes eligible may be
// more urgent than the owner, so where somebody is parked the coordinator decides. On an XPU that the
// kernel schedules there is no owner, and the word does not change: a START that is not eligible
// writes its request, looks once more, and waits; who says that an XNode has ended looks at the
// requests, and grants all that are eligible.
//
// Where the hardware preempts by levels a more urgent START is started one level above the owner, and
// nobody is suspended: `victim` is the word that it found, so that a chain of words leads down to the
// first. A FINISH goes one down; one of a job that another was started above is the coordinator's, and
// so is a START for whom there is no level. Who meets nobody, or is handed the XPU, is on the lowest.
//
// Taking is two writes, the owner word and the command, and so is giving back. Commands count, and
// each is one CAS from the one before, so that a late second write finds its turn gone:
//   - whoever takes says before the first write, in `victim` and `taking` of its own line,
//     what the second will be; the coordinator does it for a taker that has not come to it;
//   - whoever gives back may be late as well: the coordinator repeats the command to suspend, which
//     changes nothing but the count.
//
// A job that is suspended may be lent a more urgent key (its work is what a more urgent job waits
// for): its management thread writes the key, sets kFat, and rings.
//
// A START writes its request before it looks at the owner word; the coordinator looks at all
// requests, and at what has finished, after it has handed the word back. Hence no START is lost, whichever way the words are
// interleaved: tests/unit/coord/protocol_test.cc tries all ways, with deaths.
//
// A run that is not trusted has a page of its own, of the same layout, whose owner word is fat for ever: each START and
// FINISH rings. The coordinator believes nothing there but what the worker's job is doing and which XNode it is of, and
// does for it what it has to do: a worker that writes anything else delays itself.
//
// Who writes: [W] the worker of the slot, [C] the coordinator, [*] both, by the protocol above.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "coord/arbiter.h"

namespace xauto::coord {

inline constexpr std::uint32_t kShmMagic = 0x58434f52;  // "XCOR"
inline constexpr std::uint32_t kShmVersion = 11;

/// Owner word: bit 63 the coordinator decides, bit 62 somebody is parked, bit 61 the owner took the
/// XPU from its `victim`, bits 48..60 count of parkings, bits 40..47 slot + 1
/// (0: nobody), bits 0..31 generation.
inline constexpr std::uint64_t kFat = 1ull << 63;
inline constexpr std::uint64_t kParked = 1ull << 62;
inline constexpr std::uint64_t kTaken = 1ull << 61;
inline constexpr std::uint64_t kParkings = 0x1fffull << 48;
inline constexpr std::uint64_t kOneParking = 1ull << 48;
constexpr std::uint64_t owner_word(int slot, std::uint32_t generation) {
  return (static_cast<std::uint64_t>(slot) + 1) << 40 | generation;
}
constexpr int owner_slot(std::uint64_t word) {
  return static_cast<int>(word >> 40 & 0xff) - 1;
}
constexpr std::uint32_t owner_generation(std::uint64_t word) {
  return static_cast<std::uint32_t>(word);
}
constexpr std::uint64_t one_more_parked(std::uint64_t word) {
  return (word & ~kParkings) | ((word + kOneParking) & kParkings) | kParked;
}

/// Request word: bits 0..1 what the worker's job is doing, bits 2..31 its generation.
enum class Want : std::uint32_t {
  kIdle = 0,  ///< no job
  kRun = 1,   ///< has a job: running if it is the owner or was granted, parked otherwise
  kRuns = 2,  ///< kernel-scheduled XPU: runs without asking
};
inline constexpr std::uint32_t kGenerationMask = (1u << 30) - 1;
inline constexpr std::uint32_t kNoGeneration = UINT32_MAX;
constexpr std::uint32_t request_word(Want want, std::uint32_t generation) {
  return (generation & kGenerationMask) << 2 | static_cast<std::uint32_t>(want);
}
constexpr Want request_want(std::uint32_t word) {
  return static_cast<Want>(word & 3);
}
constexpr std::uint32_t request_generation(std::uint32_t word) {
  return word >> 2;
}

/// Generations go round; of two that are in use the later one is less than half a turn ahead.
constexpr bool later(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t ahead = (a - b) & kGenerationMask;
  return ahead != 0 && ahead < (1u << 29);
}

/// Level word: bits 32..61 the generation that it is for, bits 0..31 the level. A job whose
/// generation it does not have is on the lowest one.
constexpr std::uint64_t level_word(int level, std::uint32_t generation) {
  return std::uint64_t{generation} << 32 | static_cast<std::uint32_t>(level);
}
constexpr int level_of(std::uint64_t word, std::uint32_t generation) {
  return static_cast<std::uint32_t>(word >> 32) == generation
             ? static_cast<int>(static_cast<std::uint32_t>(word))
             : 0;
}

/// Command and acknowledgement: bit 0 the queue shall be suspended, bit 1 (ack only) that failed,
/// bits 2..31 count.
constexpr std::uint32_t command_word(bool suspend, std::uint32_t count) {
  return count << 2 | (suspend ? 1u : 0u);
}
inline constexpr std::uint32_t kAckFailed = 2;
constexpr std::uint32_t next_command(std::uint32_t last, bool suspend) {
  return command_word(suspend, (last >> 2) + 1);
}

struct alignas(64) WorkerLine {
  std::atomic<std::uint32_t> request{};  ///< [W]
  std::atomic<std::uint32_t> ack{};      ///< [W] management thread: last command carried out
  std::atomic<std::uint32_t> xnode{};    ///< [W] the job, written before `request`
  /// [W] The victim's command before it was taken; by levels (never both), on which one it started itself.
  std::atomic<std::uint32_t> taking{};
  std::atomic<Key> key{};                 ///< [W] what it is judged by, see rule.h
  std::atomic<std::uint64_t> sequence{};  ///< [W]
  std::atomic<std::uint64_t> since_ns{};  ///< [W] CLOCK_MONOTONIC of the request; ties, and status
  std::atomic<std::uint64_t> victim{};    ///< [W] owner_word from which it takes, or wanted to
  /// [W] management thread: while the request has the generation `lent`, its job goes by `lent_key`
  /// if that is the more urgent; written in this order.
  std::atomic<Key> lent_key{};
  std::atomic<std::uint32_t> lent{kNoGeneration};
  /// [W] management thread: when it carried out `ack`, CLOCK_MONOTONIC in us modulo 2^32. Who runs beside
  /// a queue that is being suspended knows from it for how long; nothing is decided by it.
  std::atomic<std::uint32_t> acked_us{};
};
struct alignas(64) CoordinatorLine {
  std::atomic<std::uint32_t> grant{};    ///< [*] generation that may run; a futex
  std::atomic<std::uint32_t> command{};  ///< [*] for the management thread
  std::atomic<std::uint32_t> bell{};     ///< [*] counts its wake-ups; a futex
  std::atomic<std::uint32_t> used{};     ///< [C] 1: a worker has this slot
  std::atomic<std::uint64_t> level{};    ///< [C] of the job granted, written before `grant`
  /// [W] of a run that is not trusted: the thread that says START, as its process calls it.
  std::atomic<std::uint32_t> thread{};
};
struct SlotMemory {
  WorkerLine worker;
  CoordinatorLine coordinator;
};
static_assert(sizeof(SlotMemory) == 128);

/// Whether the order constraints are kept, as the first worker said.
enum class OrderKept : std::uint8_t { kUnknown, kKept, kNotKept };

struct alignas(64) Header {
  std::uint32_t magic = 0;
  std::uint32_t version = 0;
  std::uint32_t num_xnodes = 0;
  std::uint8_t discipline = 0;
  OrderKept order = OrderKept::kUnknown;  ///< [C]
  std::uint8_t regulated = 0;             ///< 1: the page of one run, see above
  std::uint8_t pad = 0;
  std::uint32_t levels = 0;                        ///< of kLevels: how many the hardware has
  alignas(64) std::atomic<std::uint64_t> owner{};  ///< [*]
  alignas(64) std::atomic<std::uint32_t> rings{};  ///< [*] counts rings of the doorbell
  std::atomic<std::uint32_t> waiting{};    ///< [*] 1: the coordinator sleeps, ring its eventfd
  std::atomic<std::uint32_t> want_acks{};  ///< [C] 1: an acknowledgement rings, too
  std::atomic<std::uint32_t> high{};       ///< [C] slots from here on were never used
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

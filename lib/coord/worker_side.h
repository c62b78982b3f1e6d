// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 4, the worker's side of the protocol in shm_layout.h: what START, FINISH and
// an acknowledgement do to the shared words, and nothing else: no system call, no clock. `A` does
// the atomic accesses: RealAtomics here, one that tries every interleaving in the tests.
//
// All accesses are sequentially consistent where two words are involved: the proofs by exhaustion
// in tests/unit/coord/protocol_test.cc assume it.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "coord/arbiter.h"
#include "coord/rule.h"
#include "coord/shm_layout.h"

namespace xauto::coord {

struct RealAtomics {
  template <class T>
  static T load(const std::atomic<T>& x) {
    return x.load(std::memory_order_seq_cst);
  }
  /// Of a word that cannot change now, or that belongs to the one read before.
  template <class T>
  static T peek(const std::atomic<T>& x) {
    return x.load(std::memory_order_seq_cst);
  }
  template <class T>
  static void store(std::atomic<T>& x, T value) {
    x.store(value, std::memory_order_seq_cst);
  }
  /// For words that become visible with the next store().
  template <class T>
  static void store_relaxed(std::atomic<T>& x, T value) {
    x.store(value, std::memory_order_relaxed);
  }
  template <class T>
  static T exchange(std::atomic<T>& x, T value) {
    return x.exchange(value, std::memory_order_seq_cst);
  }
  template <class T>
  static T fetch_or(std::atomic<T>& x, T bits) {
    return x.fetch_or(bits, std::memory_order_seq_cst);
  }
  template <class T>
  static T fetch_add(std::atomic<T>& x, T value) {
    return x.fetch_add(value, std::memory_order_seq_cst);
  }
  /// On failure `expected` is what was there.
  template <class T>
  static bool cas(std::atomic<T>& x, T& expected, T desired) {
    return x.compare_exchange_strong(expected, desired, std::memory_order_seq_cst);
  }
};

/// Writes a grant unless a later one is there: whoever hands over may be delayed between its two
/// writes, while the job that it chose runs, ends, and is followed by the next.
template <class A>
void give(std::atomic<std::uint32_t>& grant, std::uint32_t generation) {
  std::uint32_t seen = A::load(grant);
  while (later(generation, seen) && !A::cas(grant, seen, generation)) {
  }
}

/// The second write of taking an XPU, and of giving it back; done once, by whoever comes first.
template <class A>
std::uint32_t command(std::atomic<std::uint32_t>& word, std::uint32_t last, bool suspend) {
  const std::uint32_t next = next_command(last, suspend);
  (void)A::cas(word, last, next);
  return next;
}

/// The key of the job of this generation, whose own is `own`: that one, or what was lent to it.
template <class A>
Key with_lent(const WorkerLine& line, std::uint32_t generation, Key own) {
  return A::peek(line.lent) == generation ? std::min(own, A::peek(line.lent_key)) : own;
}

/// Of the hardware, on which the job of this generation runs: as the coordinator said that let it run, or as it
/// started itself.
template <class A>
int level_in(const SlotMemory& memory, std::uint32_t generation) {
  if (A::peek(memory.coordinator.grant) == generation)
    return level_of(A::peek(memory.coordinator.level), generation);
  return static_cast<int>(A::peek(memory.worker.taking));
}

/// What is the same for all workers of an XPU.
struct Rules {
  Discipline discipline = Discipline::kPreemptive;
  Order order;
  int levels = 0;  ///< of kLevels: how many the hardware has
};

/// What the caller has to do after START.
enum class Started : std::uint8_t {
  kRuns,     ///< run
  kTook,     ///< wake the victim's management thread, and run
  kWaits,    ///< wait for the grant: a FINISH hands over
  kDecided,  ///< ring, then wait for the grant: the coordinator decides
};

struct Start {
  Started started = Started::kRuns;
  int victim = -1;  ///< slot, of kTook
};

/// What the caller has to do after FINISH.
struct Finished {
  std::uint64_t wakes = 0;  ///< bit per slot whose grant was written: wake them
  bool ring = false;        ///< the coordinator decides
  int victim = -1;          ///< slot that has the XPU back: wake its management thread
};
constexpr std::uint64_t slot_bit(int slot) {
  return 1ull << slot;
}
static_assert(kMaxSlots <= 64);

template <class A>
class Words {
 public:
  Words() = default;
  Words(Shm shm, const Rules* rules) : shm_(shm), rules_(rules) {}

  [[nodiscard]] bool eligible(const Job& job) const { return eligible(job.xnode, job.sequence); }

  Start start(int slot, std::uint32_t generation, const Job& job) const {
    WorkerLine& line = shm_.slots[slot].worker;
    A::store_relaxed(line.xnode, job.xnode);
    A::store_relaxed(line.key, job.key);
    A::store_relaxed(line.sequence, job.sequence);
    A::store_relaxed(line.since_ns, job.since_ns);
    A::store_relaxed(line.taking, 0u);
    bool may = eligible(job);
    const bool kernel = rules_->discipline == Discipline::kKernel;
    A::store(line.request, request_word(may && kernel ? Want::kRuns : Want::kRun, generation));
    if (kernel) {
      if (may) return {};
      if (!eligible(job)) return {Started::kWaits};
      give<A>(shm_.slots[slot].coordinator.grant, generation);
      return {};
    }
    std::atomic<std::uint64_t>& owner = shm_.header->owner;
    std::uint64_t seen = A::load(owner);
    for (;;) {
      if ((seen & kFat) != 0) return {Started::kDecided};
      const int other = owner_slot(seen);
      if (other >= kMaxSlots) {
        if (A::cas(owner, seen, seen | kFat)) return {Started::kDecided};
      } else if (other == slot && owner_generation(seen) == generation) {
        return {};  // handed over to us before we could park
      } else if (!may) {
        if (!A::cas(owner, seen, one_more_parked(seen))) continue;
        may = eligible(job);  // the last predecessor's FINISH may not have seen us
        if (!may) return {Started::kWaits};
        seen = A::load(owner);
      } else if (other < 0) {
        if (A::cas(owner, seen, (seen & (kParkings | kParked)) | owner_word(slot, generation)))
          return {};
      } else if (urgent_enough(job, slot, other, seen)) {
        if (rules_->discipline == Discipline::kLevels) {
          const int level = this->level(other, owner_generation(seen)) + 1;
          if (level >= rules_->levels) {
            if (A::cas(owner, seen, seen | kFat)) return {Started::kDecided};
            continue;
          }
          A::store_relaxed(line.victim, seen);
          A::store_relaxed(line.taking, static_cast<std::uint32_t>(level));
          const std::uint64_t above = (seen & (kParkings | kParked)) | owner_word(slot, generation);
          if (A::cas(owner, seen, above | kTaken)) return {};
          A::store_relaxed(line.taking, 0u);
          continue;
        }
        const std::uint32_t last = A::load(shm_.slots[other].coordinator.command);
        // One that is being resumed may be taken from at once: its management thread does what was said last.
        if ((seen & kTaken) != 0 || (last & 1u) != 0) {
          if (A::cas(owner, seen, seen | kFat)) return {Started::kDecided};
          continue;
        }
        A::store_relaxed(line.victim, seen);
        A::store_relaxed(line.taking, last);
        const std::uint64_t taken = (seen & (kParkings | kParked)) | owner_word(slot, generation);
        if (!A::cas(owner, seen, taken | kTaken)) continue;
        command<A>(shm_.slots[other].coordinator.command, last, true);
        return {Started::kTook, other};
      } else if (A::cas(owner, seen, one_more_parked(seen))) {
        return {Started::kWaits};
      }
    }
  }

  Finished finish(int slot, std::uint32_t generation, const Job& job) const {
    const bool awaited = rules_->order.tracks(job.xnode);
    if (awaited) mark_finished(job.xnode, job.sequence + 1);
    A::store(shm_.slots[slot].worker.request, request_word(Want::kIdle, generation));
    std::atomic<std::uint64_t>& owner = shm_.header->owner;
    std::uint64_t seen = A::load(owner);
    if (rules_->discipline == Discipline::kKernel) {
      if ((seen & kFat) != 0) return {0, true};
      return {awaited ? let_run() : 0};
    }
    for (;;) {
      if ((seen & kFat) != 0) return {0, true};
      if (owner_slot(seen) != slot) {  // taken from us, and over before it was suspended
        if (A::cas(owner, seen, seen | kFat)) return {0, true};
        continue;
      }
      if ((seen & kTaken) != 0) {
        const WorkerLine& line = shm_.slots[slot].worker;
        const std::uint64_t from = A::peek(line.victim);
        const Pick next = pick(slot);
        if (next.slot != owner_slot(from) || next.generation != owner_generation(from)) {
          if (A::cas(owner, seen, seen | kFat)) return {0, true};
          continue;
        }
        const std::uint64_t back =
            owner_word(next.slot, next.generation) | (from & kTaken) | (next.more ? kParked : 0);
        if (!A::cas(owner, seen, (seen & kParkings) | back)) continue;
        if (rules_->discipline == Discipline::kLevels) return {};
        command<A>(shm_.slots[next.slot].coordinator.command,
                   next_command(A::peek(line.taking), true), false);
        return {0, false, next.slot};
      }
      if ((seen & kParked) == 0) {
        if (A::cas(owner, seen, seen & kParkings)) return {};
        continue;
      }
      const Pick next = pick(slot);
      const std::uint64_t after = (seen & kParkings) | (next.more ? kParked : 0) |
                                  (next.slot < 0 ? 0 : owner_word(next.slot, next.generation));
      if (!A::cas(owner, seen, after)) continue;
      if (next.slot < 0) return {};
      give<A>(shm_.slots[next.slot].coordinator.grant, next.generation);
      return {slot_bit(next.slot)};
    }
  }

  /// This release of the XNode will never come.
  Finished skip(std::uint32_t xnode, std::uint64_t sequence) const {
    if (!rules_->order.tracks(xnode)) return {};
    mark_finished(xnode, sequence + 1);
    std::atomic<std::uint64_t>& owner = shm_.header->owner;
    std::uint64_t seen = A::load(owner);
    if (rules_->discipline == Discipline::kKernel && (seen & kFat) == 0) return {let_run()};
    while ((seen & (kFat | kParked)) == kParked && !A::cas(owner, seen, seen | kFat)) {
    }
    return {0, (seen & (kFat | kParked)) != 0};
  }

  /// Returns whether to ring.
  bool acknowledge(int slot, std::uint32_t ack) const {
    A::store(shm_.slots[slot].worker.ack, ack);
    return A::load(shm_.header->want_acks) != 0;
  }

  /// The job of this generation, which is suspended, goes by `key` if that is the more urgent. To be
  /// rung after.
  void lend(int slot, std::uint32_t generation, Key key) const {
    WorkerLine& line = shm_.slots[slot].worker;
    A::store_relaxed(line.lent_key, key);
    A::store(line.lent, generation);
    A::fetch_or(shm_.header->owner, kFat);
  }

  /// Returns whether the coordinator sleeps and must be woken through its descriptor.
  bool ring() const {
    A::fetch_add(shm_.header->rings, 1u);
    return A::exchange(shm_.header->waiting, 0u) != 0;
  }

  [[nodiscard]] bool granted(int slot, std::uint32_t generation) const {
    return A::load(shm_.slots[slot].coordinator.grant) == generation;
  }
  /// Of the hardware, on which the job of this generation runs; once it may run.
  [[nodiscard]] int level(int slot, std::uint32_t generation) const {
    return level_in<A>(shm_.slots[slot], generation);
  }

 private:
  struct Pick {
    int slot = -1;
    std::uint32_t generation = 0;
    bool more = false;  ///< others are parked, too; those of who is not eligible are
  };

  [[nodiscard]] bool eligible(std::uint32_t xnode, std::uint64_t sequence) const {
    return rules_->order.eligible(xnode, sequence,
                                  [&](std::uint32_t u) { return A::load(shm_.finished[u]); });
  }

  /// Whether a job that comes preempts the owner that `seen` names.
  bool urgent_enough(const Job& job, int slot, int other, std::uint64_t seen) const {
    if (rules_->discipline == Discipline::kGate) return false;
    return takes({job.key, job.since_ns, slot}, {key_of(other, seen), 0, other});
  }

  /// Of the owner that this word names.
  Key key_of(int owner, std::uint64_t word) const {
    const WorkerLine& line = shm_.slots[owner].worker;
    return with_lent<A>(line, owner_generation(word), A::load(line.key));
  }

  /// The most urgent eligible job that is parked (or is about to park: then it finds itself the
  /// owner), by keys of their own: whom one was lent is the owner or its victim, and the coordinator
  /// decides where that is not the choice made here.
  Pick pick(int self) const {
    std::uint32_t generations[kMaxSlots];
    Next next;
    bool ordered = false;
    const int high = static_cast<int>(A::peek(shm_.header->high));
    for (int i = 0; i < high && i < kMaxSlots; ++i) {
      if (i == self) continue;
      const WorkerLine& line = shm_.slots[i].worker;
      const std::uint32_t request = A::load(line.request);
      if (request_want(request) != Want::kRun) continue;
      if (!eligible(A::peek(line.xnode), A::peek(line.sequence))) {
        ordered = true;
        continue;
      }
      generations[i] = request_generation(request);
      next.consider({A::peek(line.key), A::peek(line.since_ns), i});
    }
    if (next.slot() < 0) return {-1, 0, ordered};
    return {next.slot(), generations[next.slot()], next.more() || ordered};
  }

  /// On an XPU that the kernel schedules: grants all that wait and are eligible by now. Their slots.
  [[nodiscard]] std::uint64_t let_run() const {
    std::uint64_t slots = 0;
    const int high = static_cast<int>(A::peek(shm_.header->high));
    for (int i = 0; i < high && i < kMaxSlots; ++i) {
      SlotMemory& memory = shm_.slots[i];
      const std::uint32_t request = A::load(memory.worker.request);
      const std::uint32_t generation = request_generation(request);
      if (request_want(request) != Want::kRun || granted(i, generation)) continue;
      if (!eligible(A::peek(memory.worker.xnode), A::peek(memory.worker.sequence))) continue;
      give<A>(memory.coordinator.grant, generation);
      slots |= slot_bit(i);
    }
    return slots;
  }

  void mark_finished(std::uint32_t xnode, std::uint64_t count) const {
    std::atomic<std::uint64_t>& finished = shm_.finished[xnode];
    std::uint64_t seen = A::load(finished);
    while (seen < count && !A::cas(finished, seen, count)) {
    }
  }

  Shm shm_;
  const Rules* rules_ = nullptr;
};

}  // namespace xauto::coord

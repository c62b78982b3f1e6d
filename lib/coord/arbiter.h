// SPDX-License-Identifier: Apache-2.0
// Life of a job, steps 5 and 10: who may use this XPU? A pure function of (state, event) ->
// actions: no clock, thread or system call, so that tests enumerate every interleaving.
//
// One slot per worker; a worker has one job at a time, or none. A slot is that job and a queue:
//
//   job:    none ──start──► waiting ──GRANT──► admitted ──finish──► none
//   queue:  enabled ──SUSPEND──► suspending ──ack──► suspended ──RESUME──► resuming ─ack─► enabled
//
// Rules (rule.h says who is more urgent, and who is eligible):
//   preemptive  the most urgent eligible job is granted at once; the queue of every other admitted
//               job is suspended; the queue of the most urgent admitted job is resumed.
//   gate        a job is granted when nobody is admitted; it runs to its end.
//   kernel      every eligible job is granted; the kernel's own scheduler keeps the priorities.
//   levels      the most urgent eligible job is granted, on a level above those of all admitted ones,
//               as soon as there is one; the hardware runs the job on the highest level.
// A job is eligible when its order predecessors (Policy::order) of the same activation have
// finished. FINISH comes from the execution thread, acks from the management thread, so a FINISH
// may overtake an ack: a queue without a job is resumed, and the slot's next job waits until the
// queue is enabled.
//
// Invariants, checked after every event in the tests: with no ack outstanding, a preemptive XPU has
// its most urgent eligible job running and no other; a gate never has two admitted jobs; a queue is
// suspended only for an admitted job; every SUSPEND is followed by RESUME or by the slot's death; of
// two jobs on levels the more urgent one is on the higher, unless a key was lent, and the most urgent
// one waits only for the highest level.
#pragma once

#include <cstdint>
#include <vector>

#include "coord/rule.h"
#include "model/platform.h"

namespace xauto::coord {

inline constexpr int kMaxSlots = 64;

enum class Phase : std::uint8_t { kNone, kWaiting, kAdmitted };
enum class Queue : std::uint8_t { kEnabled, kSuspending, kSuspended, kResuming };

struct Job {
  std::uint32_t xnode = 0;     ///< index into the app's xnodes
  std::uint64_t sequence = 0;  ///< activation it belongs to
  Key key = 0;
  std::uint64_t since_ns = 0;  ///< CLOCK_MONOTONIC of its START
};

struct Action {
  enum class Kind : std::uint8_t { kGrant, kSuspend, kResume } kind;
  int slot;
  int level = 0;  ///< of a GRANT
  bool operator==(const Action&) const = default;
};

class Arbiter {
 public:
  struct Slot {
    Phase phase = Phase::kNone;
    Queue queue = Queue::kEnabled;
    bool refuses = false;  ///< its queue could not be suspended; left alone until it finishes
    int level = 0;         ///< of an admitted job; 0 is the lowest
    Job job;
  };

  /// `order`: pairs (u, v) of xnodes on this XPU: v#k is not started before u#k has finished.
  /// `levels`: how many the hardware has; of kLevels, at least 2.
  explicit Arbiter(Discipline discipline, const OrderPairs& order = {}, int levels = 0);

  // Events. Each may make decisions: the actions to carry out, in this order, are appended to
  // `out`. Precondition violations are our own bugs and end the process (what it suspended is
  // resumed).
  void start(int slot, const Job& job, std::vector<Action>& out);
  /// A job that started before the coordinator was involved, on this level.
  void adopt(int slot, const Job& job, std::vector<Action>& out, int level = 0);
  void finish(int slot, std::vector<Action>& out);
  /// Another job took the XPU from this slot and had its queue be suspended, or gave it back and
  /// had it be resumed. Decides nothing.
  void commanded(int slot, bool suspend) {
    at(slot).queue = suspend ? Queue::kSuspending : Queue::kResuming;
  }
  /// Its job goes by `key` if that is the more urgent.
  void lend(int slot, Key key, std::vector<Action>& out);
  void suspended(int slot, bool succeeded, std::vector<Action>& out);
  void resumed(int slot, std::vector<Action>& out);
  /// The worker died or left: its job and its queue are no more.
  void gone(int slot, std::vector<Action>& out);
  /// All activations of `xnode` below `count` have finished or will never come.
  void finished(std::uint32_t xnode, std::uint64_t count, std::vector<Action>& out);

  /// Several events at once: between `begin_batch` and `end_batch` they are only noted.
  void begin_batch() { in_batch_ = true; }
  void end_batch(std::vector<Action>& out);
  /// Every job is eligible from now on. Before the first event.
  void forget_order() { order_ = Order(); }
  /// As it was found in shared memory by a new coordinator. Decides nothing.
  void restore(int slot, const Slot& state);

  /// Nobody needs the coordinator: at most one job is admitted (but where the kernel schedules), its
  /// queue is enabled or on its way there, no other queue is touched, and nobody waits whom no FINISH
  /// would find.
  [[nodiscard]] bool settled() const;
  /// The admitted job; -1 if there is none.
  [[nodiscard]] int admitted() const;
  /// An acknowledgement that is outstanding would lead to another decision.
  [[nodiscard]] bool needs_acks() const;

  [[nodiscard]] const Slot& slot(int index) const {
    static const Slot kUnused;
    const auto i = static_cast<std::size_t>(index);
    return i < slots_.size() ? slots_[i] : kUnused;
  }
  [[nodiscard]] Discipline discipline() const { return discipline_; }
  [[nodiscard]] const Order& order() const { return order_; }
  /// As it was told last.
  [[nodiscard]] std::uint64_t finished(std::uint32_t xnode) const { return finished_[xnode]; }
  /// No job and no queue in any other state than enabled: the fast path may have the XPU back.
  [[nodiscard]] bool idle() const;
  /// The slot whose job is the most urgent eligible one; -1 if there is none.
  [[nodiscard]] int most_urgent() const;
  [[nodiscard]] bool eligible(const Job& job) const;

 private:
  Slot& at(int slot) {
    if (static_cast<std::size_t>(slot) >= slots_.size())
      slots_.resize(static_cast<std::size_t>(slot) + 1);
    return slots_[static_cast<std::size_t>(slot)];
  }
  void decide(std::vector<Action>& out);
  [[nodiscard]] int high() const { return static_cast<int>(slots_.size()); }

  Discipline discipline_;
  int levels_;
  bool in_batch_ = false;
  std::vector<Slot> slots_;  ///< as many as were ever used
  Order order_;
  std::vector<std::uint64_t> finished_;  ///< [xnode] -> activations finished; of those tracked
};

}  // namespace xauto::coord

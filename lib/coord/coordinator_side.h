// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 5: the coordinator's side of the protocol in shm_layout.h, between the shared
// words and the arbiter. No system call, no clock: whom to wake is left in `Wakes`. `A` does the
// atomic accesses, see worker_side.h; the tests copy a Referee to try every interleaving.
//
// Threads: one.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "base/thread_safety.h"
#include "coord/arbiter.h"
#include "coord/regulator.h"
#include "coord/shm_layout.h"
#include "coord/worker_side.h"

namespace xauto::coord {

/// What the coordinator does to the thread of a job whose run is not trusted.
struct Hand {
  enum class Kind : std::uint8_t {
    kGive,  ///< it has the XPU
    kTake,  ///< it has not, though it may go on beside all jobs: somebody is more urgent, or its budget is spent
    kOver,  ///< its job is over
  } kind;
  int slot;
};

/// Side effects that a look asks for.
struct Wakes {
  std::vector<int> granted;    ///< futex of these slots' grant words
  std::vector<int> commanded;  ///< management threads of these slots
  std::vector<Hand> hands;     ///< in this order, before the others
  bool again = false;          ///< look again soon: a worker changes its words all the time
};

template <class A>
class Referee {
 public:
  static constexpr int kMaxRounds = 64;  ///< so that no client keeps us from the others

  /// After `max_rounds` a look ends, and asks for another one (Wakes::again).
  Referee(Shm shm, Discipline discipline, const OrderPairs& order, int levels = 0,
          int max_rounds = kMaxRounds)
      : shm_(shm), arbiter_(discipline, order, levels), max_rounds_(max_rounds) {}

  /// The next thread that calls is another one; the caller orders the two.
  void give_away() { thread_.give_away(); }

  /// Order constraints are not kept. Before the first job.
  void forget_order() {
    thread_.check();
    arbiter_.forget_order();
  }

  /// A worker has this slot from now on. The generation goes on where the slot's last user left it,
  /// so that an old owner word never matches.
  void join(int slot) {
    thread_.check();
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    SlotMemory& memory = shm_.slots[slot];
    const std::uint32_t generation = request_generation(A::load(memory.worker.request));
    info = SlotInfo{};
    info.used = true;
    info.request = request_word(Want::kIdle, generation);
    A::store(memory.worker.request, info.request);
    // So do commands: a taker of the slot's last user may still be about to write its own.
    info.command = info.ack = next_command(A::load(memory.coordinator.command), false);
    A::store(memory.worker.ack, info.ack);
    A::store(memory.coordinator.command, info.command);
    A::store(memory.coordinator.grant, generation);  // matches none that follows
    A::store(memory.coordinator.used, 1u);
    if (static_cast<std::uint32_t>(slot) >= A::peek(shm_.header->high))
      A::store(shm_.header->high, static_cast<std::uint32_t>(slot) + 1);
  }

  /// An XNode of a run that is not trusted, from now on.
  void regulate(const SporadicTask& task) { regulators_.emplace(task.xnode, task); }
  void forget(std::uint32_t xnode) { regulators_.erase(xnode); }
  [[nodiscard]] bool is_regulated(std::uint32_t xnode) const { return regulators_.contains(xnode); }

  /// A worker of such a run has this slot from now on, and its line there is in `page`. Wherever this is looked at, it
  /// may say anything.
  void join_regulated(int slot, SlotMemory* page) {
    thread_.check();
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    pages_[static_cast<std::size_t>(slot)] = page;
    const std::uint32_t generation = request_generation(A::load(page[slot].worker.request));
    info = SlotInfo{};
    info.used = info.regulated = true;
    info.request = request_word(Want::kIdle, generation);
    A::store(page[slot].worker.request, info.request);
    A::store(page[slot].coordinator.grant, generation);
    regulated_high_ = std::max(regulated_high_, slot + 1);
  }

  /// When the coordinator has to look without being rung, by the clock of `at`; 0: never.
  [[nodiscard]] std::int64_t next_look_ns() const {
    std::int64_t next = 0;
    for (int i = 0; i < regulated_high_; ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      const std::int64_t at = !info.regulated ? 0
                              : info.asks     ? info.not_before_ns
                              : info.has_xpu  ? info.since_ns + info.left_ns
                                              : 0;
      if (at != 0 && (next == 0 || at < next)) next = at;
    }
    return next;
  }
  /// Its job has had the XPU for its budget; for the tests, which have no clock.
  void spend(int slot) { slots_[static_cast<std::size_t>(slot)].left_ns = 0; }
  [[nodiscard]] bool is_spent(int slot) const {
    return slots_[static_cast<std::size_t>(slot)].left_ns <= 0;
  }
  [[nodiscard]] bool has_xpu(int slot) const {
    return slots_[static_cast<std::size_t>(slot)].has_xpu;
  }

  /// The worker of this slot is dead: whatever its words say is void.
  void leave(int slot, const std::vector<std::uint32_t>& xnodes, Wakes& wakes) {
    thread_.check();
    // First of all: a FINISH that is just handing over to the dead must not succeed.
    take_over(wakes);
    // It may have handed over, and died before it woke the other.
    for (int i = 0; i < high(); ++i)
      if (i != slot && arbiter_.slot(i).phase == Phase::kAdmitted) wakes.granted.push_back(i);
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    if (info.regulated) {
      wakes.hands.push_back({Hand::Kind::kTake, slot});
      info = SlotInfo{};
      pages_[static_cast<std::size_t>(slot)] = nullptr;
      arbiter_.gone(slot, held_actions());
      look_fat(wakes);
      return;
    }
    WorkerLine& line = shm_.slots[slot].worker;
    info.request = request_word(Want::kIdle, request_generation(A::peek(line.request)));
    A::store(line.request, info.request);
    info.used = false;
    A::store_relaxed(shm_.slots[slot].coordinator.used, 0u);
    for (const std::uint32_t xnode : xnodes)
      if (arbiter_.order().tracks(xnode)) A::store(shm_.finished[xnode], UINT64_MAX);
    arbiter_.gone(slot, held_actions());
    look_fat(wakes);
  }

  /// The time, CLOCK_MONOTONIC, of the looks that follow; it counts where some run is not trusted.
  void at(std::int64_t now_ns) { now_ns_ = now_ns; }

  /// One look at the shared words: feeds the arbiter what changed and carries out what it decides.
  void look(Wakes& wakes) {
    thread_.check();
    if (!fat_) {
      if ((A::load(shm_.header->owner) & kFat) == 0 && !some_regulated_is_new()) return;
      take_over(wakes);
    }
    look_fat(wakes);
  }

  /// A predecessor has died: everything is in the words. The slots are as good as joined; those
  /// whose workers don't come back are to `leave`.
  void rebuild(Wakes& wakes) {
    thread_.check();
    const std::uint64_t owner = A::fetch_or(shm_.header->owner, kFat);
    fat_ = true;
    arbiter_.begin_batch();
    const std::vector<Taking> takings = complete_taking(owner);
    for (int i = 0; i < high(); ++i) {
      SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      const SlotMemory& memory = shm_.slots[i];
      info.used = A::peek(memory.coordinator.used) != 0;
      if (!info.used) continue;
      claim_command(i);
      info.command = A::load(memory.coordinator.command);
      info.ack = A::load(memory.worker.ack);
      if ((info.ack & ~kAckFailed) != info.command) wakes.commanded.push_back(i);
      info.request = A::load(memory.worker.request);
      Arbiter::Slot slot;
      slot.job = read_job(i, info.request);
      const Want want = request_want(info.request);
      const std::uint32_t generation = request_generation(info.request);
      if (want == Want::kRun) {
        const bool owns = owner_slot(owner) == i && owner_generation(owner) == generation;
        const bool owned = std::any_of(takings.begin(), takings.end(), [&](const Taking& taking) {
          return taking.victim == i && taking.generation == generation;
        });
        const bool granted = A::load(memory.coordinator.grant) == generation;
        slot.phase = owns || owned || granted ? Phase::kAdmitted : Phase::kWaiting;
        if (slot.phase == Phase::kAdmitted) slot.level = started_on(memory, generation);
        // Whoever handed the XPU over to it may have died before it said so.
        if ((owns || owned) && !granted) grant(i, slot.level, generation);
        if (slot.phase == Phase::kAdmitted) wakes.granted.push_back(i);
      }
      const bool suspend = (info.command & 1u) != 0;
      const bool answered = (info.ack & ~kAckFailed) == info.command;
      const bool refused = answered && (info.ack & kAckFailed) != 0;
      if (info.command != 0) {
        slot.queue = suspend ? (answered ? Queue::kSuspended : Queue::kSuspending)
                             : (answered ? Queue::kEnabled : Queue::kResuming);
        if (refused) slot.queue = Queue::kEnabled;
        slot.refuses = refused && suspend && slot.phase == Phase::kAdmitted;
      }
      arbiter_.restore(i, slot);
    }
    look_fat(wakes);
  }

  [[nodiscard]] const Arbiter& arbiter() const { return arbiter_; }
  [[nodiscard]] bool fat() const { return fat_; }
  [[nodiscard]] bool used(int slot) const { return slots_[static_cast<std::size_t>(slot)].used; }
  [[nodiscard]] std::uint64_t decisions() const { return decisions_; }
  [[nodiscard]] const SlotMemory& memory(int slot) const {
    const SlotMemory* page = pages_[static_cast<std::size_t>(slot)];
    return (page != nullptr ? page : shm_.slots)[slot];
  }
  [[nodiscard]] Job job_of(int slot) const {
    if (const SlotInfo& info = slots_[static_cast<std::size_t>(slot)]; info.regulated)
      return info.job;
    const WorkerLine& line = shm_.slots[slot].worker;
    const std::uint32_t generation = request_generation(A::peek(line.request));
    return {A::peek(line.xnode), A::peek(line.sequence),
            with_lent<A>(line, generation, A::peek(line.key)), A::peek(line.since_ns)};
  }
  /// The same, looking at a copy of the memory; for the tests.
  void move_to(Shm shm) { shm_ = shm; }
  void move_page(int slot, SlotMemory* page) {
    if (slots_[static_cast<std::size_t>(slot)].regulated)
      pages_[static_cast<std::size_t>(slot)] = page;
  }
  /// What tells two states apart, for the tests.
  template <class Each>
  void describe(Each each) const {
    each(fat_ ? 1u : 0u);
    for (int i = 0; i < kMaxSlots; ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      if (!info.used) continue;
      for (const std::uint32_t part :
           {static_cast<std::uint32_t>(i), info.request, info.ack, info.command,
            (info.asks ? 1u : 0u) | (info.has_xpu ? 2u : 0u) | (info.left_ns <= 0 ? 4u : 0u)})
        each(part);
    }
    for (const auto& [xnode, regulator] : regulators_)
      each(static_cast<std::uint32_t>(regulator.last_begin_ns()));
  }

 private:
  struct SlotInfo {
    bool used = false;
    std::uint32_t request = 0;  ///< last seen
    std::uint32_t ack = 0;      ///< last seen
    std::uint32_t command = 0;  ///< last given
    // Of a run that is not trusted.
    bool regulated = false;
    bool asks = false;     ///< a job whose turn has not come
    bool has_xpu = false;  ///< from `since_ns` on
    Job job;
    std::int64_t not_before_ns = 0, since_ns = 0;
    std::int64_t left_ns = 0;  ///< of its budget, at `since_ns`
  };

  [[nodiscard]] int high() const {
    return std::max(std::min(static_cast<int>(A::peek(shm_.header->high)), kMaxSlots),
                    regulated_high_);
  }
  /// Where decisions of a held arbiter go: there are none.
  std::vector<Action>& held_actions() {
    nothing_.clear();
    return nothing_;
  }

  struct Taking {
    int victim = -1;
    std::uint32_t generation = 0;
  };

  /// The owner of this word took the XPU from somebody: its management thread is commanded now,
  /// whether or not the taker came to it. By levels it was started above somebody, who may have been started above
  /// the next, and nobody is commanded: the last one first.
  std::vector<Taking> complete_taking(std::uint64_t word) {
    std::vector<Taking> all;
    const bool levels = arbiter_.discipline() == Discipline::kLevels;
    while ((word & kTaken) != 0 && all.size() < kMaxSlots) {
      const int taker = owner_slot(word);
      if (taker < 0 || taker >= kMaxSlots) break;
      const WorkerLine& line = shm_.slots[taker].worker;
      const std::uint64_t from = A::peek(line.victim);
      const int victim = owner_slot(from);
      if (victim < 0 || victim >= kMaxSlots || victim == taker) break;  // a broken client
      if (A::peek(shm_.slots[victim].coordinator.used) == 0) break;
      all.insert(all.begin(), {victim, owner_generation(from)});
      word = levels ? from : 0;
      if (!levels) command<A>(shm_.slots[victim].coordinator.command, A::peek(line.taking), true);
    }
    return all;
  }

  /// Whoever gives the XPU back writes the owner word first and the command second. If that is
  /// late, it shall find another command: to suspend once more is to do nothing.
  void claim_command(int slot) {
    std::atomic<std::uint32_t>& word = shm_.slots[slot].coordinator.command;
    const std::uint32_t last = A::load(word);
    if ((last & 1u) != 0) command<A>(word, last, true);
  }

  /// From here on nobody else writes the owner word. Its owner, and from whom that took the XPU,
  /// are adopted before anybody else is heard: those jobs run.
  void take_over(Wakes& wakes) {
    arbiter_.begin_batch();
    if (fat_) return;
    const std::uint64_t word = A::fetch_or(shm_.header->owner, kFat);
    fat_ = true;
    const std::vector<Taking> takings = complete_taking(word);
    for (const Taking& taking : takings)
      if (is_shared(taking.victim)) hear(taking.victim, taking.generation, wakes);
    if (takings.empty() && arbiter_.discipline() == Discipline::kPreemptive)
      for (int i = 0; i < high(); ++i)
        if (is_shared(i)) claim_command(i);
    if (const int owner = owner_slot(word); owner >= 0 && owner < kMaxSlots)
      if (is_shared(owner)) hear(owner, owner_generation(word), wakes);
  }

  void look_fat(Wakes& wakes) {
    std::vector<Action> actions;
    for (int round = 0;; ++round) {
      if (round == max_rounds_) {
        if (!fat_) take_over(wakes);
        wakes.again = true;
        return;
      }
      arbiter_.begin_batch();
      for (int i = 0; i < high(); ++i) {
        if (slots_[static_cast<std::size_t>(i)].regulated)
          hear_regulated(i, wakes);
        else if (slots_[static_cast<std::size_t>(i)].used)
          scan_slot(i, wakes);
      }
      for (const std::uint32_t xnode : arbiter_.order().predecessors())
        arbiter_.finished(xnode, A::load(shm_.finished[xnode]), held_actions());
      arbiter_.end_batch(actions);
      const bool obeyed = carry_out(actions, wakes);
      actions.clear();
      if (obeyed) continue;  // the arbiter has to hear of it
      const std::uint32_t need = arbiter_.needs_acks() ? 1 : 0;
      if (A::peek(shm_.header->want_acks) != need) A::store(shm_.header->want_acks, need);
      // Came before the flag was up: it did not ring.
      if (need != 0 && some_ack_is_new()) continue;
      if (!hand_back()) return;
      if (!something_was_missed()) return;
      take_over(wakes);
    }
  }

  [[nodiscard]] bool some_ack_is_new() const {
    for (int i = 0; i < high(); ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      if (is_shared(i) && A::load(shm_.slots[i].worker.ack) != info.ack) return true;
    }
    return false;
  }

  /// Gives the owner word back to the workers, if none of them needs us.
  bool hand_back() {
    if (!arbiter_.settled()) return false;
    // No worker's FINISH would find it.
    for (int i = 0; i < regulated_high_; ++i)
      if (slots_[static_cast<std::size_t>(i)].regulated && arbiter_.slot(i).phase != Phase::kNone)
        return false;
    bool parked = false;
    for (int i = 0; i < kMaxSlots; ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      parked = parked || (info.used && arbiter_.slot(i).phase == Phase::kWaiting);
    }
    const bool kernel = arbiter_.discipline() == Discipline::kKernel;  // has no owner, nobody parks
    const int owner = kernel ? -1 : arbiter_.admitted();
    const std::uint64_t word = A::peek(shm_.header->owner);  // ours
    std::uint64_t back = one_more_parked(word) & (kParkings | (parked && !kernel ? kParked : 0));
    if (owner >= 0)
      back |=
          owner_word(owner, request_generation(slots_[static_cast<std::size_t>(owner)].request));
    A::store(shm_.header->owner, back);
    fat_ = false;
    return true;
  }

  /// A START or FINISH that still saw our word has written its request before that; a release that
  /// was lost, that it has finished.
  [[nodiscard]] bool something_was_missed() const {
    for (int i = 0; i < high(); ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      // Who is not trusted has rung, or hurts himself; he does not keep us here.
      if (is_shared(i) && A::load(shm_.slots[i].worker.request) != info.request) return true;
    }
    const std::vector<std::uint32_t>& predecessors = arbiter_.order().predecessors();
    return std::any_of(predecessors.begin(), predecessors.end(), [&](std::uint32_t xnode) {
      return A::load(shm_.finished[xnode]) > arbiter_.finished(xnode);
    });
  }

  [[nodiscard]] bool is_shared(int slot) const {
    const SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    return info.used && !info.regulated;
  }

  // ---- runs that are not trusted: what they write is looked at once, and nothing but their own time depends on it

  [[nodiscard]] bool some_regulated_is_new() const {
    for (int i = 0; i < regulated_high_; ++i) {
      const SlotInfo& info = slots_[static_cast<std::size_t>(i)];
      if (!info.regulated) continue;
      if (A::load(memory(i).worker.request) != info.request) return true;
      if (info.asks && now_ns_ >= info.not_before_ns) return true;
    }
    return false;
  }

  void hear_regulated(int slot, Wakes& wakes) {
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    const WorkerLine& line = memory(slot).worker;
    if (const std::uint32_t request = A::load(line.request); request != info.request) {
      if (info.has_xpu || arbiter_.slot(slot).phase != Phase::kNone ||
          request_want(info.request) == Want::kRun)
        end_regulated(slot, Hand::Kind::kOver, wakes);
      info.request = request;
      const auto regulator = regulators_.find(A::peek(line.xnode));
      const auto window = request_want(request) == Want::kRun && regulator != regulators_.end()
                              ? regulator->second.ask(now_ns_)
                              : std::nullopt;
      if (window) {
        info.job = {regulator->first, A::peek(line.sequence), window->key,
                    static_cast<std::uint64_t>(now_ns_)};
        info.not_before_ns = window->not_before_ns;
        info.left_ns = regulator->second.task().budget_ns;
        info.asks = true;
      }
    }
    if (info.asks && now_ns_ >= info.not_before_ns) {
      info.asks = false;
      arbiter_.start(slot, info.job, held_actions());
    }
    if (info.has_xpu && now_ns_ - info.since_ns >= info.left_ns)
      end_regulated(slot, Hand::Kind::kTake, wakes);
  }

  /// Its job is over, or has had the XPU for its budget: nobody waits for it any more.
  void end_regulated(int slot, Hand::Kind how, Wakes& wakes) {
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    wakes.hands.push_back({how, slot});
    info.has_xpu = info.asks = false;
    if (arbiter_.slot(slot).phase != Phase::kNone) arbiter_.finish(slot, held_actions());
  }

  /// At once: it is the coordinator that does it.
  void obey(const Action& action, Wakes& wakes) {
    SlotInfo& info = slots_[static_cast<std::size_t>(action.slot)];
    arbiter_.begin_batch();
    if (action.kind == Action::Kind::kSuspend) {
      info.left_ns -= now_ns_ - info.since_ns;
      info.has_xpu = false;
      wakes.hands.push_back({Hand::Kind::kTake, action.slot});
      arbiter_.suspended(action.slot, true, held_actions());
      return;
    }
    if (arbiter_.slot(action.slot).phase == Phase::kAdmitted) {
      info.since_ns = now_ns_;
      info.has_xpu = true;
      wakes.hands.push_back({Hand::Kind::kGive, action.slot});
    }
    if (action.kind == Action::Kind::kResume) return arbiter_.resumed(action.slot, held_actions());
    A::store(pages_[static_cast<std::size_t>(action.slot)][action.slot].coordinator.grant,
             request_generation(info.request));
    wakes.granted.push_back(action.slot);
  }

  [[nodiscard]] Job read_job(int slot, std::uint32_t& request) const {
    const WorkerLine& line = shm_.slots[slot].worker;
    Job job = job_of(slot);
    // The worker may have gone on to its next job while we read; what counts is a consistent pair.
    // A broken client that changes it all the time gets the key of one of them.
    int tries = 0;
    for (std::uint32_t again; (again = A::load(line.request)) != request && tries < kMaxRounds;
         request = again, ++tries)
      job = job_of(slot);
    if (job.xnode >= shm_.header->num_xnodes) job.xnode = 0;  // a broken client
    return job;
  }

  void scan_slot(int slot, Wakes& wakes) {
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];

    // Others took the XPU from this slot, or gave it back, and may have died before they rang.
    const std::uint32_t last = A::load(shm_.slots[slot].coordinator.command);
    const std::uint32_t ack = A::load(shm_.slots[slot].worker.ack);
    if (last != info.command) {
      info.command = last;
      arbiter_.commanded(slot, (last & 1u) != 0);
      if ((ack & ~kAckFailed) != last) wakes.commanded.push_back(slot);
    }
    // Acknowledgements before jobs: one that follows waits for the queue to be enabled.
    if (ack != info.ack) {
      info.ack = ack;
      const Queue queue = arbiter_.slot(slot).queue;
      if ((ack & ~kAckFailed) == info.command) {  // an answer to anything else is a broken client's
        if (queue == Queue::kSuspending)
          arbiter_.suspended(slot, (ack & kAckFailed) == 0, held_actions());
        if (queue == Queue::kResuming) arbiter_.resumed(slot, held_actions());
      }
    }

    hear(slot, std::nullopt, wakes);
    // A job is suspended as long as it matters, and the word is ours as long as one is.
    const WorkerLine& line = shm_.slots[slot].worker;
    if (A::load(line.lent) == request_generation(info.request) &&
        arbiter_.slot(slot).phase != Phase::kNone)
      arbiter_.lend(slot, A::peek(line.lent_key), held_actions());
  }

  /// What the worker's job is doing. `owns`: the generation of the job that has, or had, the XPU.
  void hear(int slot, std::optional<std::uint32_t> owns, Wakes& wakes) {
    SlotInfo& info = slots_[static_cast<std::size_t>(slot)];
    std::uint32_t request = A::load(shm_.slots[slot].worker.request);
    if (request == info.request && !owns) return;
    const Job job = read_job(slot, request);
    if (request != info.request && arbiter_.slot(slot).phase != Phase::kNone)
      arbiter_.finish(slot, held_actions());
    info.request = request;
    const std::uint32_t generation = request_generation(request);
    switch (request_want(request)) {
      case Want::kRun:
        if (owns == generation) {
          const int level = started_on(shm_.slots[slot], generation);
          if (arbiter_.slot(slot).phase != Phase::kAdmitted)
            arbiter_.adopt(slot, job, held_actions(), level);
          // Whoever handed the XPU over may have died before it said so.
          if (A::load(shm_.slots[slot].coordinator.grant) != generation) {
            grant(slot, level, generation);
            wakes.granted.push_back(slot);
          }
        } else if (arbiter_.slot(slot).phase == Phase::kNone) {
          arbiter_.start(slot, job, held_actions());
        }
        break;
      case Want::kRuns:  // kernel-scheduled: it neither asked nor waits
      case Want::kIdle:
        break;
    }
  }

  [[nodiscard]] int started_on(const SlotMemory& memory, std::uint32_t generation) const {
    return arbiter_.discipline() == Discipline::kLevels ? level_in<A>(memory, generation) : 0;
  }
  void grant(int slot, int level, std::uint32_t generation) {
    CoordinatorLine& line = shm_.slots[slot].coordinator;
    if (level > 0) A::store(line.level, level_word(level, generation));
    give<A>(line.grant, generation);
  }

  /// True: some of it is done already.
  bool carry_out(const std::vector<Action>& actions, Wakes& wakes) {
    bool obeyed = false;
    for (const Action& action : actions) {
      ++decisions_;
      SlotInfo& info = slots_[static_cast<std::size_t>(action.slot)];
      CoordinatorLine& line = shm_.slots[action.slot].coordinator;
      if (!info.used) continue;
      if (info.regulated) {
        obey(action, wakes);
        obeyed = obeyed || action.kind != Action::Kind::kGrant;
        continue;
      }
      if (action.kind == Action::Kind::kGrant) {
        grant(action.slot, action.level, request_generation(info.request));
        wakes.granted.push_back(action.slot);
        continue;
      }
      info.command = next_command(info.command, action.kind == Action::Kind::kSuspend);
      A::store(line.command, info.command);
      wakes.commanded.push_back(action.slot);
    }
    return obeyed;
  }

  OneThread thread_;
  Shm shm_;
  Arbiter arbiter_;
  int max_rounds_;
  bool fat_ = false;  ///< the owner word is ours
  std::array<SlotInfo, kMaxSlots> slots_;
  std::array<SlotMemory*, kMaxSlots> pages_{};  ///< [slot] null: its line is in `shm_`
  std::map<std::uint32_t, Regulator> regulators_;
  int regulated_high_ = 0;   ///< slots from here on were never of a run that is not trusted
  std::int64_t now_ns_ = 0;  ///< see `at`
  std::vector<Action> nothing_;
  std::uint64_t decisions_ = 0;
};

}  // namespace xauto::coord

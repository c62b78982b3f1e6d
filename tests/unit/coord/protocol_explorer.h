// SPDX-License-Identifier: Apache-2.0
// Every interleaving of the shared-memory protocol, on the real code: Words (START, FINISH,
// acknowledgement) and Referee (the coordinator) with atomic accesses that stop after each one.
//
// An operation is replayed: what it has read so far is recorded, so running it again from its start
// with the recorded values brings it back to where it was, and one access further on the memory as
// it is now. A state is the memory, the private state of everybody, and the records. States that
// were met before are not entered again; sequential consistency is assumed, as in worker_side.h.
//
// What sleeps here really sleeps: a worker that waits for its grant looks again only after a
// futex_wake of its slot, a management thread after a signal, the coordinator after its doorbell
// was signalled or a worker died. So a lost wake-up shows as a state in which nothing can happen.
//
// A world with too many states for that is walked through at random, from its beginning to its end
// many times: what goes wrong in few of its states is not found so.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "coord/coordinator_side.h"
#include "coord/worker_side.h"

namespace xauto::coord::testing {

/// One operation on its way.
struct Record {
  std::vector<std::uint64_t> values;
  std::size_t at = 0;
  bool stepped = false;  ///< its one access of this step is done
};
struct Stop {};

struct SteppedAtomics {
  static inline Record* record = nullptr;  ///< null: set-up, everything at once
  static constexpr std::uint32_t kXNodes = 8;
  /// Break it: what this operation takes for true of what has finished.
  enum class Belief : std::uint8_t {
    kWhatIsThere,
    kAllFinished,   ///< but its own XNode
    kWhatWasThere,  ///< ... when it looked first
  };
  static inline Belief belief = Belief::kWhatIsThere;
  static inline const std::atomic<std::uint64_t>* finished = nullptr;  ///< [kXNodes]
  static inline std::uint32_t own = 0;                                 ///< XNode
  static inline std::array<std::optional<std::uint64_t>, kXNodes> first;
  /// Break it: to this operation no command of these slots says that a queue is to be suspended.
  static inline const SlotMemory* resumed = nullptr;
  static inline std::size_t num_resumed = 0;

  template <class T>
  static T believed(const std::atomic<T>& x, T value) {
    if constexpr (std::is_same_v<T, std::uint32_t>) {
      for (std::size_t i = 0; i < num_resumed; ++i)
        if (&x == &resumed[i].coordinator.command) return value & ~1u;
    }
    if constexpr (std::is_same_v<T, std::uint64_t>) {
      if (belief == Belief::kWhatIsThere || &x < finished || &x >= finished + kXNodes) return value;
      const auto xnode = static_cast<std::size_t>(&x - finished);
      if (belief == Belief::kAllFinished) return xnode == own ? value : UINT64_MAX;
      if (!first[xnode]) first[xnode] = value;
      return *first[xnode];
    }
    return value;
  }

  template <class Access>
  static std::uint64_t access(Access now, bool yields = true) {
    if (record == nullptr) return now();
    if (record->at < record->values.size()) return record->values[record->at++];
    if (yields) {
      if (record->stepped) throw Stop{};
      record->stepped = true;
    }
    record->values.push_back(now());
    return record->values[record->at++];
  }
  template <class T>
  static T load(const std::atomic<T>& x) {
    return believed(x,
                    static_cast<T>(access([&] { return static_cast<std::uint64_t>(x.load()); })));
  }
  template <class T>
  static T peek(const std::atomic<T>& x) {
    return static_cast<T>(access([&] { return static_cast<std::uint64_t>(x.load()); }, false));
  }
  template <class T>
  static void store(std::atomic<T>& x, T value) {
    access([&] {
      x.store(value);
      return std::uint64_t{0};
    });
  }
  template <class T>
  static void store_relaxed(std::atomic<T>& x, T value) {
    access(
        [&] {
          x.store(value);
          return std::uint64_t{0};
        },
        false);
  }
  template <class T>
  static T exchange(std::atomic<T>& x, T value) {
    return static_cast<T>(access([&] { return static_cast<std::uint64_t>(x.exchange(value)); }));
  }
  template <class T>
  static T fetch_or(std::atomic<T>& x, T bits) {
    return static_cast<T>(access([&] { return static_cast<std::uint64_t>(x.fetch_or(bits)); }));
  }
  /// Only counts what nobody reads: the rings.
  template <class T>
  static T fetch_add(std::atomic<T>&, T) {
    return 0;
  }
  template <class T>
  static bool cas(std::atomic<T>& x, T& expected, T desired) {
    T seen = expected;
    const bool done =
        access([&] { return std::uint64_t{x.compare_exchange_strong(seen, desired)}; }) != 0;
    // What was there belongs to the same access.
    expected = static_cast<T>(access([&] { return static_cast<std::uint64_t>(seen); }, false));
    return done;
  }
};

struct ProtocolWorld {
  struct Task {
    int xpu = 0;
    Job job;
    bool lost = false;  ///< its release never comes
  };
  std::vector<Discipline> xpus;
  OrderPairs order;                        ///< on XPU 0
  int levels = 2;                          ///< of the XPUs that preempt by levels
  std::vector<std::vector<Task>> modules;  ///< each: its jobs, one after the other
  int deaths = 0;                          ///< workers (modules) that may die
  int coordinator_deaths = 0;
  bool may_refuse = false;
  /// Module 0's management thread may lend its running job this key, once, whenever it likes.
  std::optional<Key> lends = {};
  /// [module] its run is not trusted: it has a page of its own, its keys are those of `jobs` after its START, and it goes
  /// on beside all others while it has not the XPU. Empty: none is so.
  std::vector<bool> regulated = {};
  int cuts = 0;    ///< so many of their jobs may have had the XPU for their budget, at any time
  int forged = 0;  ///< so often they may write what they like, and go on as if nothing had been
  bool lose_alarm = false;    ///< break it: nobody tells the coordinator that a budget is spent
  bool lose_take = false;     ///< break it: whoever loses the XPU keeps it
  bool coarse = false;        ///< the coordinator does all it does at once
  bool lose_wakes = false;    ///< break it: whoever hands over does not wake
  bool blind_finish = false;  ///< break it: FINISH grants who waits for others
  bool look_once = false;     ///< break it: START does not look again when it has parked
  bool blind_taking =
      false;  ///< break it: START takes an XPU whose victim is not told to resume yet
  int max_rounds = Referee<SteppedAtomics>::kMaxRounds;  ///< of one look of the coordinator
  bool lose_again = false;  ///< break it: a look that gave up is not followed by another one
  bool verbose = false;     ///< the trail tells the words
  std::uint64_t limit = 3'000'000;  ///< states
};

struct ProtocolResult {
  std::uint64_t states = 0, steps = 0;
  bool complete = true;
  std::string violation;
  std::vector<std::string> trail;
};

class ProtocolExplorer {
  using A = SteppedAtomics;

 public:
  explicit ProtocolExplorer(ProtocolWorld world) : world_(std::move(world)) {
    for (const Discipline d : world_.xpus)
      rules_.push_back({d, Order(world_.order), world_.levels});
  }

  ProtocolResult run() {
    visit(beginning());
    return std::move(result_);
  }

  /// `walks` ways at random.
  ProtocolResult walk(int walks, std::uint32_t seed) {
    random_.emplace(seed);
    for (int i = 0; i < walks && result_.violation.empty(); ++i) {
      State at = beginning();
      for (trail_.clear();; at = std::move(*chosen_)) {
        choices_ = 0;
        chosen_.reset();
        ++result_.states;
        choose(at);
        if (!chosen_ || !result_.violation.empty()) break;
        trail_.push_back(choice_);
      }
    }
    return std::move(result_);
  }

 private:
  static constexpr std::uint32_t kXNodes = A::kXNodes;
  static constexpr std::size_t kSlots = 4;
  struct Memory {
    Header header;
    SlotMemory slots[kSlots];
    Header page_headers[kSlots];  ///< [module] of those that are not trusted, ...
    SlotMemory pages[kSlots];     ///< ... and the one line there
    std::atomic<std::uint64_t> finished[kXNodes];
  };

  enum class Act : std::uint8_t {
    kIdle,
    kStart,
    kAsk,
    kAsleep,
    kTook,
    kReturned,
    kRun,
    kFinish,
    kSkip,
    kDone,
    kDead
  };
  struct Manager {
    bool awake = false, suspended = false;
    std::uint32_t pending = 0;  ///< command last received
    int doing = 0;              ///< 0 nothing, 1 looks for a command, 2 acknowledges, 3 lends
    bool refuses = false;
    Record record = {};
  };
  struct Module {
    Act act = Act::kIdle;
    std::size_t next = 0;     ///< job it is at
    int victim = -1;          ///< of kTook and kReturned
    std::uint64_t wakes = 0;  ///< of kReturned
    bool lent = false;        ///< once
    std::uint32_t lends = 0;  ///< generation of the job to which it does
    bool has_xpu = false;     ///< by the coordinator's hand
    bool liar = false;        ///< it has written what it liked
    std::vector<std::uint32_t> generation = std::vector<std::uint32_t>(2, 0);
    Record record;
    std::vector<Manager> managers;
  };
  struct Xpu {
    Xpu(const ProtocolExplorer& explorer, std::size_t index) : memory(new Memory) {
      memory->header.num_xnodes = kXNodes;
      referee.emplace(shm(), explorer.world_.xpus[index],
                      index == 0 ? explorer.world_.order : decltype(explorer.world_.order){},
                      explorer.world_.levels, explorer.world_.max_rounds);
      discipline = explorer.world_.xpus[index];
      memory->header.waiting.store(1);
    }
    Xpu(const Xpu& other)
        : memory(new Memory),
          referee(other.referee),
          discipline(other.discipline),
          doorbell(other.doorbell),
          doing(other.doing),
          dead(other.dead),
          leaving(other.leaving),
          record(other.record) {
      std::memcpy(static_cast<void*>(memory.get()), other.memory.get(), sizeof(Memory));
      referee->move_to(shm());
      for (std::size_t m = 0; m < kSlots; ++m)
        referee->move_page(static_cast<int>(m), memory->pages);
    }
    Xpu(Xpu&&) = default;
    /// As a module sees it.
    Shm seen_by(std::size_t m, bool regulated) const {
      Shm s = shm();
      if (regulated) {
        s.header = &memory->page_headers[m];
        s.slots = memory->pages;
      }
      return s;
    }
    Shm shm() const {
      Shm s;
      s.header = &memory->header;
      s.slots = memory->slots;
      s.finished = memory->finished;
      return s;
    }
    std::unique_ptr<Memory> memory;
    std::optional<Referee<A>> referee;
    Discipline discipline = Discipline::kPreemptive;
    bool doorbell = false;
    int doing = 0;          ///< 0 asleep, 1 looks, 2 a worker has left, 3 rebuilds
    std::vector<int> dead;  ///< slots whose death it has not noticed yet
    int leaving = -1;
    Record record;
  };
  struct State {
    std::vector<Xpu> xpus;
    std::vector<Module> modules;
    int deaths = 0, coordinator_deaths = 0, cuts = 0, forged = 0;
  };

  [[nodiscard]] bool regulated(std::size_t m) const {
    return m < world_.regulated.size() && world_.regulated[m];
  }

  State beginning() const {
    State initial;
    for (std::size_t x = 0; x < world_.xpus.size(); ++x) {
      initial.xpus.emplace_back(*this, x);
      Xpu& xpu = initial.xpus[x];
      for (std::size_t m = 0; m < world_.modules.size(); ++m) {
        if (!regulated(m)) {
          xpu.referee->join(static_cast<int>(m));
          continue;
        }
        xpu.memory->page_headers[m].owner.store(kFat);
        xpu.memory->page_headers[m].waiting.store(1);
        xpu.referee->join_regulated(static_cast<int>(m), xpu.memory->pages);
        // No time passes here: the key of its first job is its window, of the next one a little later.
        for (const ProtocolWorld::Task& t : world_.modules[m])
          xpu.referee->regulate({.xnode = t.job.xnode,
                                 .period_ns = 1,
                                 .window_ns = t.job.key,
                                 .longest_ns = 1'000'000,
                                 .budget_ns = 1});
      }
    }
    initial.modules.resize(world_.modules.size());
    for (std::size_t m = 0; m < initial.modules.size(); ++m)
      for (const Xpu& xpu : initial.xpus)
        initial.modules[m].managers.push_back(
            {.pending = xpu.memory->slots[m].coordinator.command.load()});
    return initial;
  }

  void fail(const std::string& what) {
    if (!result_.violation.empty()) return;
    result_.violation = what;
    result_.trail = trail_;
  }

  // ---- one step of each kind; true: the operation is complete

  template <class Operation>
  bool advance(Record* record, Operation operation) {
    if (record == nullptr) {
      operation();
      return true;
    }
    record->at = 0;
    record->stepped = false;
    A::record = record;
    A::first = {};
    bool complete = true;
    try {
      operation();
    } catch (const Stop&) {
      complete = false;
    }
    A::record = nullptr;
    A::belief = A::Belief::kWhatIsThere;
    A::num_resumed = 0;
    if (complete) *record = {};
    return complete;
  }

  /// In the operation that follows.
  void believe(A::Belief belief, const Xpu& xpu, std::uint32_t own) {
    A::belief = belief;
    A::finished = xpu.memory->finished;
    A::own = own;
  }

  void wake(State& s, std::size_t x, int slot) {
    Module& module = s.modules[static_cast<std::size_t>(slot)];
    if (module.act == Act::kAsleep && task(module, slot).xpu == static_cast<int>(x))
      module.act = Act::kAsk;
  }
  const ProtocolWorld::Task& task(const Module& module, int index) const {
    return world_.modules[static_cast<std::size_t>(index)][module.next];
  }

  void step_start(State& s, std::size_t m) {
    Module& module = s.modules[m];
    const auto& t = task(module, static_cast<int>(m));
    Xpu& xpu = s.xpus[static_cast<std::size_t>(t.xpu)];
    const std::uint32_t generation = module.generation[static_cast<std::size_t>(t.xpu)] + 1;
    const Words<A> words(xpu.seen_by(m, regulated(m)), &rules_[static_cast<std::size_t>(t.xpu)]);
    Start start;
    Job job = t.job;
    job.since_ns = m;
    bool signal = false;
    if (world_.look_once) believe(A::Belief::kWhatWasThere, xpu, job.xnode);
    if (world_.blind_taking) {
      A::resumed = xpu.memory->slots;
      A::num_resumed = kSlots;
    }
    if (!advance(&module.record, [&] {
          start = words.start(static_cast<int>(m), generation, job);
          if (start.started == Started::kDecided) signal = words.ring();
        }))
      return;
    module.generation[static_cast<std::size_t>(t.xpu)] = generation;
    if (signal) xpu.doorbell = true;
    module.victim = start.victim;
    module.act = start.started == Started::kRuns   ? Act::kRun
                 : start.started == Started::kTook ? Act::kTook
                                                   : Act::kAsk;
  }

  void end_job(Module& module, std::size_t m) {
    module.act = ++module.next < world_.modules[m].size() ? Act::kIdle : Act::kDone;
  }

  /// Rings the management thread of the one it took the XPU from, or gave it back to; wakes whom it
  /// handed the XPU.
  void step_ring(State& s, std::size_t m) {
    Module& module = s.modules[m];
    const auto x = static_cast<std::size_t>(task(module, static_cast<int>(m)).xpu);
    for (; module.wakes != 0; module.wakes &= module.wakes - 1)
      if (!world_.lose_wakes) wake(s, x, std::countr_zero(module.wakes));
    if (module.victim >= 0) {
      Module& victim = s.modules[static_cast<std::size_t>(module.victim)];
      if (victim.act != Act::kDead && !world_.lose_wakes) victim.managers[x].awake = true;
    }
    module.victim = -1;
    if (module.act == Act::kTook)
      module.act = Act::kRun;
    else
      end_job(module, m);
  }

  /// The futex: looks and, if there is nothing, sleeps, in one.
  void step_ask(State& s, std::size_t m) {
    Module& module = s.modules[m];
    const int x = task(module, static_cast<int>(m)).xpu;
    const Shm shm = s.xpus[static_cast<std::size_t>(x)].seen_by(m, regulated(m));
    const bool granted =
        shm.slots[m].coordinator.grant.load() == module.generation[static_cast<std::size_t>(x)];
    module.act = granted ? Act::kRun : Act::kAsleep;
  }

  void step_finish(State& s, std::size_t m) {
    Module& module = s.modules[m];
    const auto& t = task(module, static_cast<int>(m));
    const auto x = static_cast<std::size_t>(t.xpu);
    if (world_.blind_finish) believe(A::Belief::kAllFinished, s.xpus[x], t.job.xnode);
    step_end(s, m, [&](const Words<A>& words) {
      return words.finish(static_cast<int>(m), module.generation[x], t.job);
    });
  }

  void step_skip(State& s, std::size_t m) {
    const auto& t = task(s.modules[m], static_cast<int>(m));
    step_end(s, m, [&](const Words<A>& words) { return words.skip(t.job.xnode, t.job.sequence); });
  }

  /// `end`: what the words say of an end, which is one or more accesses.
  template <class End>
  void step_end(State& s, std::size_t m, End end) {
    Module& module = s.modules[m];
    const auto x = static_cast<std::size_t>(task(module, static_cast<int>(m)).xpu);
    Xpu& xpu = s.xpus[x];
    const Words<A> words(xpu.seen_by(m, regulated(m)), &rules_[x]);
    Finished finished;
    bool signal = false;
    if (!advance(&module.record, [&] {
          finished = end(words);
          if (finished.ring) signal = words.ring();
        }))
      return;
    if (signal) xpu.doorbell = true;
    if (finished.victim >= 0 || finished.wakes != 0) {
      module.victim = finished.victim;
      module.wakes = finished.wakes;
      module.act = Act::kReturned;
      return;
    }
    end_job(module, m);
  }

  /// As Port::lend: the job may end meanwhile.
  void step_lend(State& s, std::size_t m, std::size_t x) {
    Module& module = s.modules[m];
    Xpu& xpu = s.xpus[x];
    const Words<A> words(xpu.shm(), &rules_[x]);
    bool signal = false;
    if (!advance(&module.managers[x].record, [&] {
          words.lend(static_cast<int>(m), module.lends, *world_.lends);
          signal = words.ring();
        }))
      return;
    if (signal) xpu.doorbell = true;
    module.managers[x].doing = 0;
  }

  void step_manager(State& s, std::size_t m, std::size_t x) {
    Manager& manager = s.modules[m].managers[x];
    Xpu& xpu = s.xpus[x];
    const Words<A> words(xpu.shm(), &rules_[x]);
    if (manager.doing == 3) return step_lend(s, m, x);
    if (manager.doing != 2) {
      manager.doing = 1;
      std::uint32_t command = 0;
      if (!advance(&manager.record,
                   [&] { command = A::load(xpu.memory->slots[m].coordinator.command); }))
        return;
      manager.doing = 0;
      if (command == manager.pending) {
        manager.awake = false;
        return;
      }
      manager.pending = command;
      if (!manager.refuses) manager.suspended = (command & 1u) != 0;
      if ((command & 1u) == 0) manager.refuses = false;
      manager.doing = 2;
      return;
    }
    bool signal = false;
    const bool refused = manager.refuses && (manager.pending & 1u) != 0;
    if (!advance(&manager.record, [&] {
          if (words.acknowledge(static_cast<int>(m), manager.pending | (refused ? kAckFailed : 0u)))
            signal = words.ring();
        }))
      return;
    if (signal) xpu.doorbell = true;
    manager.doing = 0;
    manager.refuses = false;
  }

  void step_coordinator(State& s, std::size_t x) {
    Xpu& xpu = s.xpus[x];
    if (xpu.doing == 0) {
      xpu.doorbell = false;
      if (!xpu.dead.empty()) {
        xpu.leaving = xpu.dead.back();
        xpu.dead.pop_back();
        xpu.doing = 2;
      } else {
        xpu.doing = 1;
      }
    }
    Referee<A> referee = *xpu.referee;  // as it was when the operation began
    Wakes wakes;
    Header& header = xpu.memory->header;
    if (!advance(world_.coarse ? nullptr : &xpu.record, [&] {
          if (xpu.doing == 3) {
            referee.rebuild(wakes);
          } else {
            A::store(header.waiting, 0u);
            if (xpu.doing == 2) {
              std::vector<std::uint32_t> xnodes;
              for (const auto& t : world_.modules[static_cast<std::size_t>(xpu.leaving)])
                xnodes.push_back(t.job.xnode);
              referee.leave(xpu.leaving, xnodes, wakes);
            }
          }
          A::store(header.waiting, 1u);
          for (std::size_t m = 0; m < s.modules.size(); ++m)
            if (regulated(m)) A::store(xpu.memory->page_headers[m].waiting, 1u);
          referee.look(wakes);
        }))
      return;
    xpu.referee.emplace(std::move(referee));
    xpu.doing = 0;
    xpu.leaving = -1;
    if (wakes.again && !world_.lose_again) xpu.doorbell = true;
    for (const Hand& hand : wakes.hands)
      if (const bool gives = hand.kind == Hand::Kind::kGive; gives || !world_.lose_take)
        s.modules[static_cast<std::size_t>(hand.slot)].has_xpu = gives;
    for (const int slot : wakes.granted) wake(s, x, slot);
    for (const int slot : wakes.commanded) {
      Module& module = s.modules[static_cast<std::size_t>(slot)];
      if (module.act != Act::kDead) module.managers[x].awake = true;
    }
  }

  // ---- what must hold

  [[nodiscard]] bool alive(const Module& module) const {
    return module.act != Act::kDead && module.act != Act::kDone;
  }

  /// Its exec has returned, or never will.
  [[nodiscard]] bool over(const State& s, std::uint32_t xnode, std::uint64_t sequence) const {
    for (std::size_t m = 0; m < s.modules.size(); ++m) {
      const Module& module = s.modules[m];
      const bool ends = module.act == Act::kFinish || module.act == Act::kSkip;
      for (std::size_t i = module.next + (ends ? 1 : 0); i < world_.modules[m].size(); ++i)
        if (const Job& job = world_.modules[m][i].job;
            job.xnode == xnode && job.sequence == sequence)
          return module.act == Act::kReturned || module.act == Act::kDead;
    }
    return true;
  }

  void check_always(const State& s) {
    for (std::size_t m = 0; m < s.modules.size(); ++m) {
      if (s.modules[m].act != Act::kRun) continue;
      const ProtocolWorld::Task& t = task(s.modules[m], static_cast<int>(m));
      for (const auto& [u, v] : world_.order)
        if (t.xpu == 0 && v == t.job.xnode && !over(s, u, t.job.sequence))
          fail("a job runs although one that its policy orders before it has not ended");
    }
    for (std::size_t x = 0; x < s.xpus.size(); ++x) {
      if (s.xpus[x].discipline == Discipline::kLevels) check_levels(s, x);
      if (s.xpus[x].discipline != Discipline::kGate) continue;
      int owners = 0;
      for (std::size_t m = 0; m < s.modules.size(); ++m)
        if (s.modules[m].act == Act::kRun &&
            task(s.modules[m], static_cast<int>(m)).xpu == static_cast<int>(x))
          ++owners;
      if (owners > 1) fail("two owners of a gate");
    }
  }

  [[nodiscard]] int level(const State& s, std::size_t m, std::size_t x) const {
    return Words<RealAtomics>(s.xpus[x].shm(), &rules_[x])
        .level(static_cast<int>(m), s.modules[m].generation[x]);
  }
  [[nodiscard]] bool runs_on(const State& s, std::size_t m, std::size_t x) const {
    return s.modules[m].act == Act::kRun &&
           task(s.modules[m], static_cast<int>(m)).xpu == static_cast<int>(x);
  }

  /// Of two jobs that run, the hardware prefers the more urgent.
  void check_levels(const State& s, std::size_t x) {
    for (std::size_t m = 0; m < s.modules.size(); ++m) {
      if (!runs_on(s, m, x)) continue;
      if (level(s, m, x) >= world_.levels) fail("a level that the hardware lacks");
      for (std::size_t n = 0; n < s.modules.size(); ++n) {
        if (m == n || !runs_on(s, n, x)) continue;
        const Key a = task(s.modules[m], static_cast<int>(m)).job.key,
                  b = task(s.modules[n], static_cast<int>(n)).job.key;
        if (a < b ? level(s, m, x) <= level(s, n, x) : level(s, m, x) == level(s, n, x))
          fail("the hardware prefers the less urgent job");
      }
    }
  }

  /// Nothing is under way but jobs that run and starts that may come.
  void check_quiet(const State& s) {
    for (std::size_t x = 0; x < s.xpus.size(); ++x) {
      if (s.xpus[x].discipline == Discipline::kKernel) continue;
      int running = 0;
      Next next;
      for (std::size_t m = 0; m < s.modules.size(); ++m) {
        const Module& module = s.modules[m];
        if (regulated(m)) {
          // What it says of itself need not be true.
          const Arbiter::Slot& slot = s.xpus[x].referee->arbiter().slot(static_cast<int>(m));
          if (module.has_xpu && slot.phase == Phase::kNone)
            fail("what is over, or cut, has the XPU");
          if (module.has_xpu && s.xpus[x].referee->is_spent(static_cast<int>(m)))
            fail("a job that has had the XPU for its budget has it");
          if (slot.phase == Phase::kNone) continue;
          running += module.has_xpu ? 1 : 0;
          next.consider({slot.job.key, slot.job.since_ns, static_cast<int>(m)});
          continue;
        }
        if (module.act != Act::kRun && module.act != Act::kAsleep) continue;
        const auto& t = task(module, static_cast<int>(m));
        if (t.xpu != static_cast<int>(x)) continue;
        const bool runs = module.act == Act::kRun && !module.managers[x].suspended;
        running += runs ? 1 : 0;
        if (!Words<RealAtomics>(s.xpus[x].shm(), &rules_[x]).eligible(t.job)) {
          if (runs) fail("a job runs before its order predecessors have finished");
          continue;
        }
        const WorkerLine& line = s.xpus[x].memory->slots[m].worker;
        next.consider({with_lent<RealAtomics>(line, module.generation[x], t.job.key), m,
                       static_cast<int>(m)});
      }
      const int top = next.slot();
      if (top < 0) continue;
      if (running == 0) fail("an XPU stands idle although somebody wants it");
      const Module& first = s.modules[static_cast<std::size_t>(top)];
      if (s.xpus[x].discipline == Discipline::kLevels && first.act != Act::kRun) {
        bool full = false;
        for (std::size_t m = 0; m < s.modules.size(); ++m)
          full = full || (runs_on(s, m, x) && level(s, m, x) + 1 == world_.levels);
        if (!full) fail("the most urgent job waits although there is a level for it");
      }
      if (s.xpus[x].discipline == Discipline::kPreemptive) {
        if (regulated(static_cast<std::size_t>(top))
                ? !first.has_xpu
                : first.act != Act::kRun || first.managers[x].suspended)
          fail("the most urgent job does not run");
        if (running > 1 && !world_.may_refuse) fail("two jobs run on a preemptive XPU");
      }
    }
  }

  void check_end(const State& s) {
    for (const Module& module : s.modules) {
      if (module.act == Act::kDead || module.liar) continue;
      if (module.act != Act::kDone) fail("a job is never run: nothing can happen any more");
      for (const Manager& manager : module.managers)
        if (manager.suspended) fail("a queue stays suspended");
    }
  }

  // ---- all ways

  struct Hash {
    std::uint64_t a = 0x9e3779b97f4a7c15u, b = 0xc2b2ae3d27d4eb4fu;
    void add(std::uint64_t v) {
      a = (a ^ v) * 0xff51afd7ed558ccdu;
      a ^= a >> 32;
      b = (b + v) * 0xc4ceb9fe1a85ec53u;
      b ^= b >> 29;
    }
    void add(const Record& record) {
      add(record.values.size() + 77);
      for (const std::uint64_t v : record.values) add(v);
    }
    bool operator==(const Hash&) const = default;
  };
  /// States met before, in one piece of memory: there are tens of millions.
  class Seen {
   public:
    /// False: it was there.
    bool insert(const Hash& hash) {
      if (++count_ * 4 > table_.size() * 3) grow();
      return put(hash);
    }

   private:
    bool put(const Hash& hash) {
      std::size_t at = hash.a & (table_.size() - 1);
      while (!(table_[at] == Hash{0, 0})) {
        if (table_[at] == hash) {
          --count_;
          return false;
        }
        at = (at + 1) & (table_.size() - 1);
      }
      table_[at] = hash;
      return true;
    }
    void grow() {
      std::vector<Hash> old(table_.size() * 2, Hash{0, 0});
      old.swap(table_);
      for (const Hash& hash : old)
        if (!(hash == Hash{0, 0})) put(hash);
    }
    std::vector<Hash> table_ = std::vector<Hash>(1024, Hash{0, 0});
    std::size_t count_ = 0;
  };

  Hash key(const State& s) const {
    Hash h;
    h.add(static_cast<std::uint64_t>((s.deaths * 16 + s.coordinator_deaths) * 256 + s.cuts * 16 +
                                     s.forged));
    for (const Xpu& xpu : s.xpus) {
      const Memory& memory = *xpu.memory;
      h.add(memory.header.owner.load());
      h.add(memory.header.waiting.load() * 2 + memory.header.want_acks.load());
      for (std::size_t i = 0; i < s.modules.size(); ++i) {
        const SlotMemory& slot = memory.slots[i];
        h.add(std::uint64_t{slot.worker.request.load()} << 32 | slot.worker.ack.load());
        h.add(std::uint64_t{slot.coordinator.grant.load()} << 32 | slot.coordinator.command.load());
        h.add(static_cast<std::uint64_t>(slot.worker.key.load()) * 2 +
              slot.coordinator.used.load());
        h.add(slot.worker.victim.load());
        h.add(slot.worker.taking.load());
        h.add(slot.coordinator.level.load());
        if (world_.lends) h.add(slot.worker.lent.load());
        if (!regulated(i)) continue;
        const SlotMemory& page = memory.pages[i];
        h.add(std::uint64_t{page.worker.request.load()} << 32 | page.coordinator.grant.load());
        h.add(memory.page_headers[i].waiting.load() + 2u * page.worker.xnode.load());
      }
      for (const auto& f : memory.finished) h.add(f.load());
      xpu.referee->describe([&](std::uint32_t part) { h.add(part); });
      const Arbiter& arbiter = xpu.referee->arbiter();
      for (std::size_t i = 0; i < s.modules.size(); ++i) {
        const Arbiter::Slot& slot = arbiter.slot(static_cast<int>(i));
        h.add(static_cast<std::uint64_t>(slot.phase) << 8 |
              static_cast<std::uint64_t>(slot.queue) << 4 | (slot.refuses ? 1u : 0u) |
              static_cast<std::uint64_t>(slot.job.key) << 16);
      }
      h.add(static_cast<std::uint64_t>(xpu.doing * 4 + (xpu.doorbell ? 1 : 0)) * 64 +
            static_cast<std::uint64_t>(xpu.leaving + 1));
      for (const int slot : xpu.dead) h.add(static_cast<std::uint64_t>(slot) + 1000);
      h.add(xpu.record);
    }
    for (const Module& module : s.modules) {
      h.add((static_cast<std::uint64_t>(module.act) * 64 + module.next) * 8 +
            static_cast<std::uint64_t>(module.victim + 1));
      h.add(module.wakes);
      h.add((module.has_xpu ? 1u : 0u) | (module.liar ? 4u : 0u));
      if (world_.lends) h.add(std::uint64_t{module.lends} << 1 | (module.lent ? 1u : 0u));
      for (const std::uint32_t g : module.generation) h.add(g);
      h.add(module.record);
      for (const Manager& manager : module.managers) {
        h.add(static_cast<std::uint64_t>(manager.awake) |
              static_cast<std::uint64_t>(manager.suspended) << 1 |
              static_cast<std::uint64_t>(manager.refuses) << 2 |
              static_cast<std::uint64_t>(manager.doing) << 3 |
              static_cast<std::uint64_t>(manager.pending) << 8);
        h.add(manager.record);
      }
    }
    return h;
  }

  template <class Apply>
  void go(const State& from, const char* what, std::size_t who, std::size_t where, Apply apply) {
    if (!result_.violation.empty() || !result_.complete) return;
    const auto name = [&] {
      return std::string(what) + " " + std::to_string(who) + " on " + std::to_string(where);
    };
    ++result_.steps;
    if (random_) {
      if ((*random_)() % ++choices_ != 0) return;
      choice_ = name();
      chosen_.emplace(from);
      apply(*chosen_);
      check_always(*chosen_);
      return;
    }
    State to = from;
    trail_.push_back(name());
    apply(to);
    if (world_.verbose) {
      const Memory& m = *to.xpus[0].memory;
      char line[200];
      std::snprintf(line, sizeof line,
                    "  owner %llx waiting %u bell %d fat %d | req %x %x grant %x %x",
                    static_cast<unsigned long long>(m.header.owner.load()), m.header.waiting.load(),
                    to.xpus[0].doorbell ? 1 : 0, to.xpus[0].referee->fat() ? 1 : 0,
                    m.slots[0].worker.request.load(), m.slots[1].worker.request.load(),
                    m.slots[0].coordinator.grant.load(), m.slots[1].coordinator.grant.load());
      trail_.back() += line;
    }
    check_always(to);
    visit(to);
    trail_.pop_back();
  }

  void visit(const State& s) {
    if (!result_.violation.empty() || !seen_.insert(key(s))) return;
    if (++result_.states > world_.limit) {
      result_.complete = false;
      result_.trail = trail_;
      return;
    }
    choose(s);
  }

  /// A budget ends, or it writes what it likes, and rings. Whether it has the XPU: then a budget will end.
  bool choose_of_regulated(const State& s, std::size_t m) {
    bool ends = false;
    for (std::size_t x = 0; x < s.xpus.size(); ++x) {
      const Referee<A>& referee = *s.xpus[x].referee;
      if (const int slot = static_cast<int>(m); s.xpus[x].doing == 0 && referee.has_xpu(slot) &&
                                                !referee.is_spent(slot) && s.cuts < world_.cuts) {
        ends = true;
        go(s, "budget of", m, x, [&](State& to) {
          ++to.cuts;
          to.xpus[x].referee->spend(static_cast<int>(m));
          if (!world_.lose_alarm) to.xpus[x].doorbell = true;
        });
      }
      if (s.forged >= world_.forged || s.modules[m].act == Act::kDead) continue;
      const std::uint32_t generation = s.modules[m].generation[x];
      for (const std::uint32_t word :
           {request_word(Want::kIdle, generation), request_word(Want::kRun, generation),
            request_word(Want::kRun, generation + 1), UINT32_MAX})
        go(s, "forgery of", m, x, [&](State& to) {
          ++to.forged;
          to.modules[m].liar = true;
          SlotMemory& page = to.xpus[x].memory->pages[m];
          page.worker.request.store(word);
          page.worker.key.store(INT64_MIN);
          page.coordinator.grant.store(word);
          page.coordinator.command.store(word);
          to.xpus[x].memory->page_headers[m].owner.store(0);
          to.xpus[x].doorbell = true;
        });
    }
    return ends;
  }

  /// What may happen next, and what must hold if nothing is under way.
  void choose(const State& s) {
    bool busy = false, possible = false;
    for (std::size_t x = 0; x < s.xpus.size(); ++x) {
      const Xpu& xpu = s.xpus[x];
      if (xpu.doing != 0 || xpu.doorbell || !xpu.dead.empty()) {
        busy = true;
        go(s, "coordinator", x, x, [&](State& to) { step_coordinator(to, x); });
      }
      if (s.coordinator_deaths < world_.coordinator_deaths)
        go(s, "coordinator dies", x, x, [&](State& to) {
          ++to.coordinator_deaths;
          Xpu& at = to.xpus[x];
          if (at.leaving >= 0 && at.memory->slots[at.leaving].coordinator.used.load() != 0)
            at.dead.push_back(at.leaving);
          at.leaving = -1;
          at.record = {};
          at.referee.emplace(at.shm(), at.discipline,
                             x == 0 ? world_.order : decltype(world_.order){}, world_.levels);
          at.doing = 3;
          // Management threads see the closed socket, come back, and look for commands again.
          for (Module& module : to.modules)
            if (module.act != Act::kDead)
              module.managers[x].awake |=
                  module.managers[x].pending !=
                  at.memory->slots[&module - to.modules.data()].coordinator.command.load();
        });
    }
    for (std::size_t m = 0; m < s.modules.size(); ++m)
      if (regulated(m)) possible = choose_of_regulated(s, m) || possible;
    for (std::size_t m = 0; m < s.modules.size(); ++m) {
      const Module& module = s.modules[m];
      if (module.act == Act::kDead) continue;
      const auto at = module.act == Act::kDone
                          ? std::size_t{0}
                          : static_cast<std::size_t>(task(module, static_cast<int>(m)).xpu);
      switch (module.act) {
        case Act::kIdle:
          possible = true;
          if (task(module, static_cast<int>(m)).lost) {
            go(s, "module skips", m, at, [&](State& to) {
              to.modules[m].act = Act::kSkip;
              step_skip(to, m);
            });
            break;
          }
          go(s, "module starts", m, at, [&](State& to) {
            to.modules[m].act = Act::kStart;
            step_start(to, m);
          });
          break;
        case Act::kStart:
          busy = true;
          go(s, "module starts", m, at, [&](State& to) { step_start(to, m); });
          break;
        case Act::kTook:
        case Act::kReturned:
          busy = true;
          go(s, "module rings", m, at, [&](State& to) { step_ring(to, m); });
          break;
        case Act::kAsk:
          busy = true;
          go(s, "module asks", m, at, [&](State& to) { step_ask(to, m); });
          break;
        case Act::kRun:
          if (module.managers[at].suspended) break;
          possible = true;
          go(s, "module finishes", m, at, [&](State& to) {
            to.modules[m].act = Act::kFinish;
            step_finish(to, m);
          });
          break;
        case Act::kFinish:
          busy = true;
          go(s, "module finishes", m, at, [&](State& to) { step_finish(to, m); });
          break;
        case Act::kSkip:
          busy = true;
          go(s, "module skips", m, at, [&](State& to) { step_skip(to, m); });
          break;
        case Act::kAsleep:
        case Act::kDone:
        case Act::kDead:
          break;
      }
      for (std::size_t x = 0; x < s.xpus.size(); ++x) {
        const Manager& manager = module.managers[x];
        if (world_.lends && m == 0 && !module.lent && module.act == Act::kRun && x == at &&
            manager.doing == 0)
          go(s, "manager lends", m, x, [&](State& to) {
            Module& lender = to.modules[m];
            lender.lent = true;
            lender.lends = lender.generation[x];
            lender.managers[x].doing = 3;
            step_lend(to, m, x);
          });
        if (!manager.awake && manager.doing == 0) continue;
        busy = true;
        go(s, "manager", m, x, [&](State& to) { step_manager(to, m, x); });
        if (world_.may_refuse && manager.doing == 0 && !manager.refuses && !manager.suspended)
          go(s, "manager refuses", m, x, [&](State& to) {
            to.modules[m].managers[x].refuses = true;
            step_manager(to, m, x);
          });
      }
      if (s.deaths < world_.deaths && module.act != Act::kIdle && module.act != Act::kDone)
        go(s, "module dies", m, at, [&](State& to) {
          ++to.deaths;
          Module& dead = to.modules[m];
          dead.act = Act::kDead;
          dead.record = {};
          for (Manager& manager : dead.managers) manager = {};
          for (Xpu& xpu : to.xpus) xpu.dead.push_back(static_cast<int>(m));
        });
    }
    if (!busy) check_quiet(s);
    if (!busy && !possible) check_end(s);
  }

  ProtocolWorld world_;
  std::vector<Rules> rules_;
  ProtocolResult result_;
  Seen seen_;
  std::vector<std::string> trail_;
  std::optional<std::mt19937> random_;  ///< a walk
  std::uint32_t choices_ = 0;           ///< ... of this step so far, one of which is
  std::optional<State> chosen_;
  std::string choice_;
};

}  // namespace xauto::coord::testing

// SPDX-License-Identifier: Apache-2.0
// Life of a job, steps 2 and 11: a module fires when all its inputs are fresh, its chain of XNodes
// runs, its outputs are published.
//
//            all inputs fresh                 last XNode finished
//   idle ────────────────────────► busy ──────────────────────────► idle, or busy if inputs waited
//
// One activation is in flight at a time, since the XNodes share the module's state. Each input
// keeps its newest message: one that is replaced before it was used is an overrun, counted.
//
// Where the sources of a component have one rate, activation k of each of its modules stems from
// release k of them (Graph::Module::numbered). A release that is lost somewhere (exec failed, overrun) is then lost for everything downstream: an
// envelope without a message, a tombstone, travels in its place, so that nobody waits for it:
// neither a join of several inputs nor a job that is ordered after one of the lost activation
// (Policy::order).
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "base/pi_mutex.h"
#include "base/ring.h"
#include "graph/graph.h"
#include "model/deployment.h"
#include "runtime/input_access.h"
#include "transport/topic.h"

namespace xauto::runtime {

/// What a module asks of its surroundings; implemented by the engine (and by tests).
class ModuleHost {
 public:
  virtual ~ModuleHost() = default;
  /// Run the chain of `module` from its first XNode, on its workers.
  virtual void activate(int module) = 0;
  /// Activation `sequence` of `module` is over: done, or dropped for `reason` (XAUTO_DROP_*).
  virtual void done(int module, std::int64_t origin_ns, std::uint64_t sequence) = 0;
  virtual void dropped(int module, std::uint64_t sequence, std::uint32_t reason) = 0;
  /// Node `node` of the graph has ended its job of the activation in flight of `module`; asked for
  /// where a chain ends inside.
  virtual void passed(int /*module*/, int /*node*/) {}
  /// No XNode of `module` will start a job of an activation up to `sequence` any more.
  virtual void skip(int module, std::uint64_t sequence) = 0;
};

/// Threads: `receive` from any thread, `finish` from the thread that ran the last XNode.
class ModuleRuntime {
 public:
  /// `outputs`: the channels of the module's output topics, in their order; `memories`: where their
  /// messages are made.
  ModuleRuntime(const Graph& graph, int index, ModuleHost& host,
                std::vector<const transport::Channel*> outputs,
                std::vector<detail::MessageMemory*> memories = {});
  // Before the first message.
  void set_overload(Overload overload) {
    const Guard lock(mutex_);
    overload_ = overload;
  }
  /// How much earlier than its message's origin the activation counts as released, by input.
  void shift_origins(std::vector<std::int64_t> by_ns) { shift_ns_ = std::move(by_ns); }
  /// Several rates: fires with messages whose origins are at most `tolerance_ns` apart, the oldest
  /// such ones first; a message that can have no partner any more is lost.
  void match_within(std::int64_t tolerance_ns) { match_ns_ = tolerance_ns; }
  /// `abandon` may be called.
  void watch() { watched_ = true; }
  /// Numbered: releases below `next` are settled already.
  void begin_at(std::uint64_t next) {
    const Guard lock(mutex_);
    next_ = next;
    for (InputQueue& queue : queues_) queue.expected = next;
  }

  /// A message (or tombstone) for input number `input`; beyond the inputs: for a sampled topic.
  void receive(int input, const detail::Envelope& envelope);
  /// The first XNode of the current activation is about to run: what is sampled is read now. By
  /// the thread that runs it.
  void begin(std::int64_t now_ns);
  /// The chain of the current activation has ended.
  void finish(bool succeeded);

  /// See ModuleHost::passed.
  void passed(int node) { host_.passed(index_, node); }

  /// Gives up activation `sequence`, whose exec does not return: it is lost, and so is everything
  /// that comes until `finish` is called for it after all. False: it has ended. Any thread.
  bool abandon(std::uint64_t sequence);
  /// The activation in flight was given up.
  [[nodiscard]] bool abandoned() const {
    return fate_.load(std::memory_order_acquire) == Fate::kAbandoned;
  }

  // Of the current activation; stable while it is in flight.
  [[nodiscard]] void* state() { return state_.get(); }
  [[nodiscard]] const Input& input() const { return input_; }
  /// When the sensor released what input number `input` was given.
  [[nodiscard]] std::int64_t origin_of(std::size_t input);
  /// By source, the oldest of what the current activation is made from; null: see
  /// Graph::tells_origins. From `begin` on.
  [[nodiscard]] const std::shared_ptr<const detail::Origins>& origins() const { return origins_; }

 private:
  struct InputQueue {
    Ring<detail::Envelope> waiting;  ///< in order; at most one unless queued
    std::uint64_t expected = 0;      ///< numbered: number of the next message
  };
  /// Releases first..last were lost for `reason`; told to the host without the mutex.
  struct Lost {
    std::uint64_t first, last;
    std::uint32_t reason;
  };

  void settle(std::uint64_t below, std::uint32_t reason, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  void arrive(InputQueue& queue, const detail::Envelope& envelope, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  void lose_while_hung(InputQueue& queue, const detail::Envelope& envelope, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  void resolve(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool matched(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  void gather_origins();
  void finish_abandoned();
  bool take_if_fresh(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  void put_off(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  void tell(const std::vector<Lost>& lost, std::uint64_t skip_below);

  const Graph::Module& module_;
  const bool numbered_, tells_origins_;
  const int index_;
  ModuleHost& host_;
  std::vector<const transport::Channel*> outputs_;
  std::vector<detail::MessageMemory*> memories_;  ///< of the outputs; null: the heap
  std::vector<std::shared_ptr<const void>>
      taken_;  ///< of finish; a member, so that it keeps its memory
  std::vector<detail::TopicSpec> topics_;
  std::shared_ptr<void> state_;

  PiMutex mutex_;  ///< nothing is called while it is held
  std::vector<InputQueue> queues_ XAUTO_GUARDED_BY(mutex_);
  const std::size_t newest_from_ = queues_.size();  ///< numbers of inputs from here on are sampled
  std::vector<detail::Envelope> newest_ XAUTO_GUARDED_BY(mutex_);  ///< by sampled topic
  std::size_t empty_ XAUTO_GUARDED_BY(mutex_) =
      0;  ///< a queue that was empty when last looked at: the first to look at
  bool busy_ XAUTO_GUARDED_BY(mutex_) = false;
  Overload overload_ XAUTO_GUARDED_BY(mutex_);
  std::uint64_t next_ XAUTO_GUARDED_BY(mutex_) =
      0;  ///< numbered: releases below this number are settled, taken or lost
  /// Numbered: skip up to here (exclusive), and send the tombstone, once the activation in
  /// flight has ended: it is older than what was lost and must not be taken for finished, nor
  /// overtaken downstream.
  std::uint64_t skip_below_ XAUTO_GUARDED_BY(mutex_) = 0;
  /// Numbered: losses newer than the activation in flight, told after its end: releases are
  /// settled in order, and whoever hears of k+1 takes an untold k for lost.
  std::vector<Lost> later_ XAUTO_GUARDED_BY(mutex_);

  bool hung_ XAUTO_GUARDED_BY(mutex_) = false;  ///< the activation in flight was given up

  /// Of the activation in flight: `finish` and `abandon` race for it.
  enum class Fate : std::uint8_t { kOpen, kEnding, kAbandoned };
  std::atomic<Fate> fate_{Fate::kOpen};
  bool watched_ = false;
  std::int64_t match_ns_ = -1;
  std::vector<std::int64_t> shift_ns_;  ///< [input]

  // Of the current activation; written under the mutex before it starts.
  Input input_ = InputAccess::make();
  std::shared_ptr<const detail::Origins> origins_;
};

}  // namespace xauto::runtime

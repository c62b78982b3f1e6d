// SPDX-License-Identifier: Apache-2.0
// Life of a job, steps 2 and 11: a module fires when all its inputs are fresh, its chain of XNodes
// runs, its outputs are published.
//
//            all inputs fresh                 last XNode finished, and what is older is settled
//   free ────────────────────────► in flight ──────────────────────────────────────► free again
//
// One activation is in flight at a time, since the XNodes share the module's state; or N, with a
// state each (XModule::in_flight). Then each XNode takes activations in order, and they are settled
// in order: results leave so, and who fails holds its place. Each input keeps its newest message:
// one that is replaced before it was used is an overrun, counted.
//
// Where the sources of a component have one rate, activation k of each of its modules stems from
// release k of them (Graph::Module::numbered). A release that is lost somewhere (exec failed,
// overrun) is then lost for everything downstream: an envelope without a message, a tombstone,
// travels in its place, so that nobody waits for it: neither a join of several inputs nor a job that
// is ordered after one of the lost activation (Policy::order).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "base/pi_mutex.h"
#include "base/ring.h"
#include "graph/graph.h"
#include "model/deployment.h"
#include "processes/parameters.h"
#include "runtime/activation.h"
#include "transport/topic.h"

namespace xauto::runtime {

/// What a module asks of its surroundings; implemented by the engine (and by tests).
class ModuleHost {
 public:
  virtual ~ModuleHost() = default;
  /// Run the chain of `module` from its first XNode, on the workers of that activation.
  virtual void activate(int module, Activation& activation) = 0;
  /// Go on with it at position `node` of the chain: it was parked there.
  virtual void proceed(int module, Activation& activation, std::size_t node) = 0;
  /// An activation is settled: done, or dropped for `reason` (XAUTO_DROP_*).
  virtual void done(int module, const Activation& activation) = 0;
  virtual void dropped(int module, std::uint64_t sequence, std::uint32_t reason) = 0;
  /// One that was activated is no longer in flight; after `done` or `dropped`.
  virtual void left(int /*module*/) {}
  /// Node `node` of the graph has ended its job; asked for where a chain ends inside.
  virtual void passed(int /*module*/, const Activation& /*activation*/, int /*node*/) {}
  /// What the activation that begins has read of the topics that `module` samples, in their order.
  virtual void sampled(int /*module*/, std::span<const detail::Envelope> /*messages*/) {}
  /// No XNode of `module` will start a job of an activation up to `sequence` any more.
  virtual void skip(int module, std::uint64_t sequence) = 0;
};

/// Threads: `receive` from any thread; what takes an activation, from the thread that runs it.
class alignas(64) ModuleRuntime {
 public:
  /// `outputs`: the channels of the module's output topics, in their order; `memories`: where their
  /// messages are made. `in_flight`: how many activations may be at once, each with a state.
  ModuleRuntime(const Graph& graph, int index, ModuleHost& host,
                std::vector<const transport::Channel*> outputs,
                std::vector<detail::MessageMemory*> memories = {}, int in_flight = 1);
  // Before the first message.
  void set_overload(Overload overload) {
    const Guard lock(mutex_);
    overload_ = overload;
    skips_ = overload.kind == Overload::Kind::kSkip;
  }
  /// How much earlier than its message's origin the activation counts as released, by input.
  void shift_origins(const std::vector<std::int64_t>& by_ns) {
    const Guard lock(mutex_);
    for (std::size_t i = 0; i < queues_.size(); ++i) queues_[i].shift_ns = by_ns[i];
  }
  /// Several rates: fires with messages whose origins are at most `tolerance_ns` apart, the oldest
  /// such ones first; a message that can have no partner any more is lost.
  void match_within(std::int64_t tolerance_ns) { match_ns_ = tolerance_ns; }
  /// Activations see what this reads when they begin.
  void read_parameters(ParameterReader reader);
  /// `abandon` may be called.
  void watch() { watched_ = true; }
  /// Its program may mark what it publishes urgent (XModule::urgent_if), once in so many releases; 0: nothing certifies
  /// that. Counted in `line`. Before the run.
  void let_mark(std::uint64_t apart, ModuleLine& line) {
    if (module_.spec->urgent_if) marks_line_ = &line;
    marks_apart_ = apart;
  }
  /// Activations have the tables that the board says of their nominal releases. It outlives this. `off`: by
  /// table, whether its releases leave the module out; empty: none does.
  void read_tables(const Board& board, std::vector<char> off) {
    tables_ = &board;
    off_ = std::move(off);
  }
  /// Numbered: releases below `next` are settled already.
  void begin_at(std::uint64_t next) {
    const Guard lock(mutex_);
    next_ = next;
    for (InputQueue& queue : queues_) queue.expected = next;
  }
  /// Messages that wait, of the input that has the most. Any thread.
  [[nodiscard]] std::size_t waiting();
  /// An activation is told to have left before the next one is told to be activated.
  [[nodiscard]] bool one_at_a_time() const { return only_ != nullptr && !watched_; }
  [[nodiscard]] Activation& activation(std::size_t index) { return *activations_[index]; }

  /// A message (or tombstone) for input number `input`; beyond the inputs: for a sampled topic.
  void receive(int input, const detail::Envelope& envelope);
  /// Its next XNode may take it. False: an older one is not through with that XNode; somebody will
  /// `proceed` with it.
  bool enter(Activation& activation) { return only_ != nullptr || may_enter(activation); }
  /// The first XNode is about to run: what is sampled is read now. `now_ns` counts where it
  /// `samples()`; 0 otherwise.
  void begin(Activation& activation, std::int64_t now_ns);
  [[nodiscard]] bool samples() const { return !module_.samples.empty(); }
  /// Whether that does anything.
  [[nodiscard]] bool looks_first() const { return looks_first_; }
  /// It is through with its next XNode, and not at its end.
  void pass(Activation& activation) {
    if (only_ == nullptr) let_others_in(activation);
  }
  /// Nobody hears of its results.
  [[nodiscard]] bool ends_inside() const { return outputs_.empty(); }
  /// Its chain has ended.
  void finish(Activation& activation, bool succeeded);

  /// See ModuleHost::passed.
  void passed(const Activation& activation, int node) { host_.passed(index_, activation, node); }

  /// Activation `sequence` has ended `late_ns` after the key of its last XNode.
  void missed(std::uint64_t sequence, std::int64_t late_ns) const;

  /// Gives up activation `sequence`, whose exec does not return: it is lost. Its room is taken until
  /// `finish` is called for it after all; without room for others everything that comes is lost,
  /// too. False: it has ended. Any thread.
  bool abandon(std::uint64_t sequence);

 private:
  struct InputQueue {
    Ring<detail::Envelope> waiting;  ///< in order; at most one unless queued
    std::uint64_t expected = 0;      ///< numbered: number of the next message
    std::int64_t shift_ns = 0;       ///< see shift_origins
  };
  /// Releases first..last were lost for `reason`; told to the host without the mutex.
  struct Lost {
    std::uint64_t first = 0, last = 0;
    std::uint32_t reason = 0;
  };
  /// What is settled in its turn: an activation, or what was lost between two of them.
  struct Turn {
    Activation* activation = nullptr;  ///< null: `lost`
    Lost lost;
  };
  /// Releases below `below` were left out; `origin_ns`: of their tombstone, which says why.
  struct Skipped {
    std::uint64_t below = 0;  ///< 0: none
    std::int64_t origin_ns = 0;
  };
  /// Activations that the caller has to run, in order.
  struct Started {
    Activation *first = nullptr, *last = nullptr;
    void add(Activation& activation);
  };

  void settle(std::uint64_t below, std::uint32_t reason, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool arrives_alone(InputQueue& queue, const detail::Envelope& envelope)
      XAUTO_REQUIRES(mutex_);
  void arrive(InputQueue& queue, const detail::Envelope& envelope, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  void lose_while_hung(InputQueue& queue, const detail::Envelope& envelope, std::vector<Lost>& lost)
      XAUTO_REQUIRES(mutex_);
  void resolve(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool matched(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool fresh(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  void take(Activation& activation, std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool leaves_out(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::uint32_t table_of(std::int64_t released_ns) const {
    return tables_->table_of(static_cast<std::uint64_t>(released_ns) / 1000);
  }
  void fire(std::vector<Lost>& lost, Started& started) XAUTO_REQUIRES(mutex_) {
    // Asked at each message and each end: mostly an input is still missing.
    const bool missing = queues_[empty_].waiting.empty() && lost.empty();
    if (!missing || overload_.kind == Overload::Kind::kQueue) fire_all(lost, started);
  }
  void fire_all(std::vector<Lost>& lost, Started& started) XAUTO_REQUIRES(mutex_);
  void line_up(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_) {
    if (numbered_ && !lost.empty()) take_turns(lost);
  }
  void take_turns(std::vector<Lost>& lost) XAUTO_REQUIRES(mutex_);
  /// An activation that may be fired.
  [[nodiscard]] Activation* room() XAUTO_REQUIRES(mutex_) {
    if (only_ == nullptr) return room_of_several();
    return only_->stage_ == Activation::Stage::kFree ? only_ : nullptr;
  }
  [[nodiscard]] Activation* room_of_several() XAUTO_REQUIRES(mutex_);
  void empty(Activation& activation) XAUTO_REQUIRES(mutex_);
  /// The oldest of all that is not settled has ended.
  [[nodiscard]] bool over() XAUTO_REQUIRES(mutex_) {
    if (turns_.empty()) return false;
    const Activation* oldest = turns_.front().activation;
    return oldest == nullptr || oldest->stage_ == Activation::Stage::kSucceeded ||
           oldest->stage_ == Activation::Stage::kFailed;
  }
  void collect() XAUTO_REQUIRES(order_);
  void collect_locked() XAUTO_REQUIRES(order_, mutex_) {
    for (; over(); turns_.pop_front()) {
      settled_.push_back(turns_.front());
      ending_ = ending_ || turns_.front().activation != nullptr;
    }
  }
  [[nodiscard]] bool held(const Activation& activation) XAUTO_REQUIRES(mutex_);
  void unpark(Started& free) XAUTO_REQUIRES(mutex_);

  void take_parameters(Activation& activation);
  void gather_origins(Activation& activation);
  bool may_enter(Activation& activation);
  void let_others_in(Activation& activation);
  void give_back(Activation& activation);
  void proceed(Started parked);
  void activate(Started started) {
    if (started.first != nullptr) activate_all(started);
  }
  void activate_all(Started started);
  /// Tells what was collected, and what that makes room for.
  void tell_settled(std::vector<Lost>& lost, Started& started) XAUTO_REQUIRES(order_) {
    while (!settled_.empty()) tell_collected(lost, started);
  }
  void tell_collected(std::vector<Lost>& lost, Started& started) XAUTO_REQUIRES(order_);
  void tell(const Turn& turn, Skipped& skipped) XAUTO_REQUIRES(order_);
  void tell(Activation& activation, bool succeeded, Skipped& skipped) XAUTO_REQUIRES(order_);
  void settle_only(Activation& activation, bool succeeded, std::vector<Lost>& lost,
                   Started& started) XAUTO_REQUIRES(order_);
  void tell_skipped(Skipped& skipped) XAUTO_REQUIRES(order_) {
    if (skipped.below != 0) skip(std::exchange(skipped, {}));
  }
  void skip(Skipped skipped) XAUTO_REQUIRES(order_);
  /// Numbered: all below `below` were, and what comes next is not told yet.
  void skip_below(std::uint64_t below, std::int64_t origin_ns, Skipped& skipped)
      XAUTO_REQUIRES(order_) {
    if (skipped.origin_ns != origin_ns) tell_skipped(skipped);
    if (numbered_) skipped = {below, origin_ns};
  }
  void tell(const std::vector<Lost>& lost) {
    if (!lost.empty()) tell_all(lost);
  }
  void tell_all(const std::vector<Lost>& lost);
  [[nodiscard]] bool may_mark(std::uint64_t sequence) XAUTO_REQUIRES(order_);

  // In the order of use: what each message and each end asks for lies together.
  const std::size_t newest_from_;  ///< numbers of inputs from here on are sampled
  const int index_;
  const bool numbered_, tells_origins_;
  bool looks_first_;  ///< before its first XNode runs
  bool watched_ = false;
  bool skips_ = false;  ///< set before the run
  std::int64_t match_ns_ = -1;
  ModuleHost& host_;
  const Board* tables_ = nullptr;
  std::vector<char> off_;  ///< [table]
  std::vector<std::unique_ptr<Activation>> activations_;
  Activation* only_ = nullptr;  ///< where one is in flight at a time

  PiMutex mutex_;  ///< nothing is called while it is held
  /// Held while it is told what was settled, so that it is told in order. Before `mutex_`; before
  /// those of modules downstream.
  PiMutex order_;
  std::vector<InputQueue> queues_ XAUTO_GUARDED_BY(mutex_);
  std::size_t empty_ XAUTO_GUARDED_BY(mutex_) =
      0;  ///< a queue that was empty when last looked at: the first to look at
  std::uint64_t next_ XAUTO_GUARDED_BY(mutex_) =
      0;  ///< numbered: releases below this number are settled, taken or lost
  std::size_t hung_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< activations that were given up
  bool ending_ XAUTO_GUARDED_BY(mutex_) = false;   ///< an end is being told: there is room soon
  Overload overload_ XAUTO_GUARDED_BY(mutex_);
  std::uint64_t fired_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< activations so far
  /// What is not settled yet, the oldest first. Numbered: what was lost is told in its turn, since
  /// whoever hears of k + 1 takes an untold k for lost.
  Ring<Turn> turns_ XAUTO_GUARDED_BY(mutex_);
  std::vector<Turn> settled_ XAUTO_GUARDED_BY(order_);  ///< a member, so that it keeps its memory
  ModuleLine* marks_line_ = nullptr;  ///< null: its program marks nothing; set before the run
  std::uint64_t marks_apart_ = 0;     ///< likewise
  std::optional<std::uint64_t> last_marked_ XAUTO_GUARDED_BY(order_);

  const Graph::Module& module_;
  std::vector<const transport::Channel*> outputs_;
  std::vector<detail::MessageMemory*> memories_;  ///< of the outputs; null: the heap
  std::vector<detail::TopicSpec> topics_;
  std::vector<detail::Envelope> newest_ XAUTO_GUARDED_BY(mutex_);  ///< by sampled topic
  ParameterReader parameters_;  ///< of whoever begins: activations begin one after the other
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Evaluator: the makespan of one (assignment, priority order) after another, incrementally; each
// XNode may also wait for one other XNode of its XPU (a pair of PriorityPlan::order).
//
// The same rule as simulate.cc (problem.h), written for the search: a candidate differs from the
// committed schedule in a few XNodes, and nothing can differ before the first of these becomes
// ready. So the simulation restarts at the last snapshot before that instant, and stops as soon as
// an XNode becomes ready too late for the limit: ready + wcet + longest chain behind it under the
// current assignment. One pair per XNode reaches every WCET schedule that any set of pairs reaches:
// of those it waits for, the one that finishes last decides. Schedules that are ordered on every
// XPU have a faster evaluator of their own (ordered.h).
//
// Threads: one owner. Units: microseconds.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

inline constexpr Time kNever = std::numeric_limits<Time>::max() / 4;

class Evaluator {
 public:
  explicit Evaluator(const Problem& problem);

  /// Commits `xpu`, `sequence` (XNodes, most urgent first) and `waits_for` (empty: nobody waits)
  /// with a full simulation. kNever if some wait for each other.
  void reset(const std::vector<int>& xpu, const std::vector<int>& sequence,
             const std::vector<int>& waits_for = {});

  // A candidate: any number of edits of the committed solution, evaluate(), then commit() or
  // rollback().
  void assign(int xnode, int xpu);
  /// Moves `xnode` to `position` of the sequence; those between shift by one.
  void reposition(int xnode, int position);
  /// `xnode` does not start before `other` has finished (-1: nobody). Dormant while they are on
  /// different XPUs.
  void wait_for(int xnode, int other);
  /// The makespan, or kNever once it is certain to be >= `limit`, or if some wait for each other.
  [[nodiscard]] Time evaluate(Time limit);
  void commit();
  void rollback();

  /// Of the committed solution; the cost where Problem::goal asks for something else.
  [[nodiscard]] Time makespan() const { return makespan_; }
  [[nodiscard]] const std::vector<int>& xpu() const { return solution_.xpu; }
  [[nodiscard]] const std::vector<int>& sequence() const { return solution_.sequence; }
  [[nodiscard]] int position(int xnode) const {
    return solution_.position[static_cast<std::size_t>(xnode)];
  }
  /// As given, dormant ones too.
  [[nodiscard]] const std::vector<int>& waits_for() const { return solution_.waits_for; }
  // Of the committed schedule.
  [[nodiscard]] Time ready(int xnode) const {
    return committed_.ready_at[static_cast<std::size_t>(xnode)];
  }
  [[nodiscard]] Time start(int xnode) const {
    return committed_.started_at[static_cast<std::size_t>(xnode)];
  }
  [[nodiscard]] Time finish(int xnode) const {
    return committed_.finished_at[static_cast<std::size_t>(xnode)];
  }
  [[nodiscard]] Time load(int xpu) const { return solution_.load[static_cast<std::size_t>(xpu)]; }
  [[nodiscard]] Time tail(int xnode) const {
    return solution_.tail[static_cast<std::size_t>(xnode)];
  }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  /// The XNodes that set the makespan, last first: each was delayed by the next one, as its
  /// predecessor or as the one that held its XPU.
  void critical_chain(std::vector<int>& chain) const;

 private:
  enum Status : std::uint8_t { kWaiting, kReady, kRunning, kDone };
  /// Who follows whom, flat.
  struct Links {
    std::vector<int> succ_begin, succ_list, pred_begin, pred_list;
    std::vector<int> topo_rank, sources;
  };
  /// What is decided, and what follows from that alone.
  struct Solution {
    std::vector<int> xpu, sequence, position;
    std::vector<int> waits_for;
    std::vector<int> first_waiting, next_waiting;  ///< lists of those that wait for the same one
    int waiting = 0;
    std::vector<Time> work;  ///< wcet on the assigned XPU
    std::vector<Time> tail;  ///< longest chain behind, under the assignment
    std::vector<Time> load;  ///< per XPU
  };
  /// Of a simulation, at an instant.
  struct State {
    Time now = 0;
    Time latest = 0, charged = 0;
    std::vector<std::uint8_t> status;
    std::vector<std::uint16_t> missing;
    std::vector<Time> remaining;
    std::vector<int> running;
    std::vector<Time> end;
  };
  struct Schedule {
    std::vector<Time> released_at;  ///< the last predecessor has finished
    std::vector<Time> ready_at;     ///< and so has whom it waits for
    std::vector<Time> started_at, finished_at;
  };
  /// States of the committed schedule's simulation, to begin again from.
  struct Snapshots {
    std::vector<State> all;
    std::size_t used = 0, stride = 1;
  };

  template <bool kRecord>
  Time run(Time limit);
  void start_from_scratch();
  void restore(const State& snapshot);
  void save(State& snapshot, Time now, Time latest) const;
  [[nodiscard]] Time cost() const;
  template <bool kRecord>
  void decide(int xpu, Time now);
  /// Of the XNodes ready on `xpu`, how many have started.
  [[nodiscard]] int suspended(std::size_t xpu) const;
  void move_position(int xnode, int position);
  void update_tails(int xnode);
  void push_ready(int xnode);
  void link(int xnode, int other);
  [[nodiscard]] bool held(std::size_t i) const {
    const int other = solution_.waits_for[i];
    return other >= 0 && state_.status[static_cast<std::size_t>(other)] != kDone &&
           solution_.xpu[static_cast<std::size_t>(other)] == solution_.xpu[i];
  }
  [[nodiscard]] bool hangs() const;

  const Problem& problem_;
  std::size_t n_, m_;
  Links links_;
  Solution solution_;
  Time makespan_ = 0;

  // Of the simulation; what stays from one to the next is in its state.
  State state_;
  std::vector<std::uint16_t> in_degree_;
  std::vector<std::uint64_t> ready_;  // [xpu * words_ + k]: bit per place in the sequence
  std::vector<int> ready_count_;
  std::size_t words_;
  std::vector<char> touched_;
  std::vector<int> touched_list_;

  Schedule committed_;
  Snapshots kept_;

  struct Edit {
    int xnode, old_xpu, old_position, old_waits_for;
  };
  std::vector<Edit> edits_;
  Time dirty_from_ = kNever;
  std::vector<char> in_queue_;
  mutable std::vector<int> on_xpu_;  // critical_chain's
  mutable std::vector<std::size_t> xpu_begin_;
  std::int64_t evaluations_ = 0;
};

}  // namespace xauto::solver

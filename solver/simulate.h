// SPDX-License-Identifier: Apache-2.0
// The exact event-driven simulator: what an assignment and its priorities do, to the microsecond.
#pragma once

#include <span>
#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

enum class Model {
  kXAuto,      ///< fixed priorities, preemption with cost: the rule in problem.h
  kRos2,       ///< each stage on its fastest XPU type; CPUs shared fairly, others round-robin
  kTimeshare,  ///< the policy's assignment without scheduling: every instance time-shares
};

/// One stretch of time during which an XNode (or a context switch on its behalf) holds an XPU.
struct Slice {
  int xnode = -1, xpu = -1;
  Time begin = 0, end = 0;
  bool switching = false;  ///< preemption or context-switch cost, not progress
};

struct Simulation {
  Time makespan = 0;
  std::vector<int> xpu;  ///< where each XNode ran; for kRos2 on a pool: the type's first instance
  std::vector<Time> start, finish;
  std::vector<Slice>
      slices;  ///< only if asked for; in shared (processor-sharing) models they overlap
  std::int64_t preemptions = 0;
};

struct SimulateOptions {
  bool slices = false;
  /// Actual execution times instead of the WCETs, [xnode], each in 0..WCET; empty: WCET.
  std::span<const Time> actual = {};
  /// kRos2/kTimeshare: ideal sharing without time slices or switch cost, whatever the platform
  /// says.
  bool ideal_sharing = false;
};

/// kXAuto: the rule of problem.h.
[[nodiscard]] Simulation simulate(const Problem& problem, const Decision& decision,
                                  const SimulateOptions& options = {});

/// simulate() for many runs of one Problem: no allocation after the first set(), makespan and
/// finishes only. The same rule, another shape: XNodes are renumbered by XPU and urgency, so that
/// "the most urgent ready one" is the first bit set. Threads: one owner; keep `problem` alive.
class Simulator {
 public:
  explicit Simulator(const Problem& problem);
  void set(const Decision& decision);
  /// Makespan with the WCETs, or with `actual` execution times ([xnode]).
  Time run(std::span<const Time> actual = {});
  [[nodiscard]] Time finish(int xnode) const {  ///< of the last run
    return finish_[static_cast<std::size_t>(slot_of_[static_cast<std::size_t>(xnode)])];
  }

 private:
  void make_ready(int slot);

  const Problem& problem_;
  std::vector<int> slot_of_, xnode_of_, xpu_of_;  ///< slots: XNodes by (XPU, most urgent first)
  std::vector<int> succ_begin_, succ_;            ///< by slot; precedence and run-time order
  std::vector<int> waits_for_, waits_left_;
  std::vector<Time> work_, left_, finish_;    ///< by slot
  std::vector<int> first_slot_, first_word_;  ///< by XPU, one more at the end
  std::vector<std::uint64_t> ready_;
  std::vector<char> started_;
  std::vector<int> open_;     ///< by XPU: how many of its slots have started and not ended
  std::vector<int> running_;  ///< by XPU: slot or -1
  std::vector<Time> end_;     ///< by XPU
  std::vector<char> touched_;
  std::vector<int> touched_list_;
  std::vector<std::pair<std::int64_t, int>> sort_;
};

/// kRos2 (decision ignored) and kTimeshare. CPU-type XPUs: ideal processor sharing (a job never
/// gets more than one core); in kRos2 the cores are one pool, in kTimeshare each core is shared by
/// the XNodes assigned to it. Every other XPU: round-robin by timeslice_us, effective_switch_us at
/// each change of context, in order of arrival; timeslice_us = 0: ideal sharing. kRos2 with several
/// instances of a type: an arriving XNode joins the instance with the fewest XNodes at that moment
/// (lowest index first).
[[nodiscard]] Simulation simulate_shared(const Problem& problem, const Platform& platform,
                                         Model model, const Decision& decision,
                                         const SimulateOptions& options = {});

}  // namespace xauto::solver

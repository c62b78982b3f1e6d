// SPDX-License-Identifier: Apache-2.0
// In a run with tables: which scenario the run is in, by what jobs took, what people ask for and what the machine says.
// Asked before each release (TableSwitch); and looked at in between by a thread, so that what no scenario covers is said
// at once.
//
// A job past its WCET is no matter if the scenario in force when it ended, or the one that is chosen
// for the next release, covers it: then a change is claimed with it. Else it is counted, and nothing is
// claimed, also where it was too little for another scenario (kEmulatorStallUs).
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "grid/context.h"
#include "session/account.h"
#include "session/claimed_wcets.h"
#include "tables/condition_watch.h"
#include "tables/outside_log.h"
#include "tables/scenario_choice.h"

namespace xauto::runtime {

/// Threads: one, that of the releases, then that of the report; and its own.
class ScenarioWatch {
 public:
  /// Has it told to the board how long the jobs that run here have had their XPUs by now. Any thread.
  using TellTimes = std::function<void(std::int64_t now_ns)>;
  /// The run has tables.
  [[nodiscard]] static Result<std::unique_ptr<ScenarioWatch>> start(const Context& context,
                                                                    TellTimes tell_times);
  /// What is chosen by now.
  [[nodiscard]] Choice now() const;
  /// What shall be in force from the next release on. `in_force`: the scenario that was until now. Never waits.
  [[nodiscard]] Choice choose(int in_force);
  /// Why it was chosen, as far as a job is the reason.
  [[nodiscard]] std::string words_of(const Choice& choice) const;
  /// No job runs any more: looks for the last time, and ends the thread. Idempotent.
  void stop(int in_force);
  /// Adds what was outside of every scenario.
  void report(Account& into) const;

 private:
  ScenarioWatch(const Context& context, TellTimes tell_times);
  /// True: what is in force does not hold. On the thread.
  [[nodiscard]] bool glance(const MachineState& machine);
  void look(const MachineState& machine) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::vector<std::string> outside(const Choice& choice, const MachineState& machine)
      XAUTO_REQUIRES(mutex_);
  void take_past() XAUTO_REQUIRES(mutex_);
  void judge_past(int in_force) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] const std::string& name_of(int xnode) const {
    return context_.session.app.xnodes[static_cast<std::size_t>(xnode)].name;
  }
  [[nodiscard]] std::string words_of(const Passing& job) const;

  const Context& context_;
  const TellTimes tell_times_;
  const Tables& tables_;
  mutable PiMutex mutex_;  ///< of the releases and the thread; nobody logs or waits under it
  ScenarioChoice choice_ XAUTO_GUARDED_BY(mutex_);
  std::vector<std::size_t> node_of_;  ///< [XNode] -> graph node
  const ClaimedWcets claimed_;
  /// Jobs past a WCET since the last choice, as XNodeLine has them.
  struct Past {
    std::uint64_t jobs = 0, longest = 0;
  };
  std::vector<Past> past_ XAUTO_GUARDED_BY(mutex_);            ///< [XNode]
  std::vector<std::uint64_t> hangs_ XAUTO_GUARDED_BY(mutex_);  ///< [XNode] that were looked at
  OutsideLog outside_ XAUTO_GUARDED_BY(mutex_);
  std::unique_ptr<ConditionWatch> conditions_;  ///< last: its thread uses the others
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Before a job's first step, in a run with tables: which of them a release has. The release keeps it to
// its end, in all processes.
//
//   before each release   what jobs took, and take ──► ScenarioChoice ──► the scenario, its table
//   another table         the sensors wait until all that is in flight has ended; then the release,
//                         and the table's number, go out together
//
// Tables are of version 1: what they claim is about releases that meet no other. So the wait is what
// keeps the claim of the change (Change::worst_case_us), and as far as that holds it is at most
// Change::delay_us. Where it made a release late, the ones after it wait likewise, until one is on time.
// One that is later than a period and the longest such delay is not released at all: it is lost, and
// counted.
//
// A job that runs too long is seen by the next release, which is the first that can have another table.
// In another process its watchdog tells (HangWatch).
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "runtime/condition_watch.h"
#include "runtime/context.h"
#include "runtime/ledger.h"
#include "runtime/scenario_choice.h"
#include "runtime/wiring.h"
#include "session/run_report.h"

namespace xauto::runtime {

/// Threads: one, that of the releases, then that of the report.
class TableSwitch {
 public:
  /// Null in a run without tables. Errors: the app has several rates.
  [[nodiscard]] static Result<std::unique_ptr<TableSwitch>> make(const Context& context,
                                                                 const Wiring& wiring,
                                                                 const Ledger& ledger);

  /// Release `release` is about to be published: gives it its table. `drained` waits until all
  /// earlier ones have ended; false: it gave up, then the table stays. Returns whether it waited.
  bool before(std::uint64_t release, const std::function<bool()>& drained);
  /// A release that should have been at `due_ns` is so late at `now_ns` that it is left out.
  [[nodiscard]] bool too_late(std::int64_t now_ns, std::int64_t due_ns) const;

  /// After the last release has ended.
  void report(RunReport& into);
  /// What was outside of every scenario, a line each; after the run.
  [[nodiscard]] std::vector<std::string> broken() const;

 private:
  TableSwitch(const Context& context, const Wiring& wiring, const Ledger& ledger);
  void look();
  void judge(std::uint64_t below, SwitchReport* change);
  void put(std::uint64_t release, int table);
  void tell(SwitchReport change, const Choice& choice);
  void tell_outside(const Choice& choice);
  [[nodiscard]] const Change* change_of(int from, int to) const;
  [[nodiscard]] std::string words_of(const Choice& choice) const;

  const Context& context_;
  const Wiring& wiring_;
  const Ledger& ledger_;
  const Tables& tables_;
  ScenarioChoice choice_;
  ConditionWatch conditions_;
  std::vector<std::size_t> node_of_;  ///< [XNode] -> graph node
  std::vector<std::uint64_t> hangs_;  ///< [XNode] that were looked at
  std::int64_t period_ns_ = 0;        ///< 0: none is stated
  std::int64_t longest_delay_ns_ = 0;
  int table_ = 0;     ///< in force
  int scenario_ = 0;  ///< the one that was told; the choice is ahead of it while a drain fails
  std::uint64_t judged_ = 0;  ///< releases whose latency is counted
  bool catches_up_ = false;   ///< the next release waits for the one before
  bool outside_ = false, stuck_ = false;
  int lost_ = -1;  ///< the XPU that was last told to be lost
  std::deque<SwitchReport> switches_;
  std::uint64_t num_switches_ = 0;
  struct Outside {
    std::uint64_t times = 0;
    std::string first;
  };
  Outside jobs_, clocks_;
};

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
// Before a job's first step, in a run with tables: which of them a release has. The release keeps it to
// its end, in all processes.
//
// What is nominally released from an instant on has the new table, and keys decide between jobs of both. What that
// may cost is Handover::worst_case_us, as long as the change before has settled; a release that would need
// another table sooner keeps the one in force, is counted, and nothing is claimed then. Nor is it after a
// change that was made later than the certificate counts with (Tables::notice_us): a job had been too long
// for more than that when a release still had the old table. Where nothing is claimed of some chain, the
// change drains (model/drain.h): for so long nothing is released, and what comes from then on has the new
// table's claims. Where an XPU is lost that the old table uses, it does not: what hangs there may never end.
//
// Where the app releases one at a time nothing is in flight when a release has its table: no change waits, and the
// next release has what its own scenario claims. (In a recorded input releases may meet: the ledger counts that, and
// nothing is claimed.) The one before, whose jobs asked for the change, has
// Handover::worst_case_us; of a change that keeps the table, the table's.
//
// A job that runs too long decides for the next release, which is the first that can have another table
// (scenario_watch.h). In another process its watchdog tells (HangWatch).
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include <xauto/result.h>

#include "account/ledger.h"
#include "base/thread_safety.h"
#include "grid/context.h"
#include "session/run_report.h"
#include "tables/scenario_watch.h"

namespace xauto::runtime {

/// The microsecond from which on a new table counts: that of the release that is about to be
/// published at `nominal_ns`, unless something was already, up to `newest_ns`, which keeps its table.
constexpr std::uint64_t first_us_of_table(std::int64_t nominal_ns, std::int64_t newest_ns) {
  return static_cast<std::uint64_t>(std::max(nominal_ns / 1000, newest_ns / 1000 + 1));
}

/// A job has been too long for `too_long_ns` by now. False: a release got the old table more than
/// the notice after it had begun to be.
constexpr bool noticed_in_time(std::int64_t now_ns, std::int64_t too_long_ns,
                               std::int64_t last_release_ns, std::int64_t notice_ns) {
  return last_release_ns <= now_ns - too_long_ns + notice_ns;
}

/// Threads: one, that of the releases, then that of the report.
class TableSwitch {
 public:
  /// Null in a run without tables.
  /// `show`: told of each table as soon as releases get it, the first as well; what it does is short.
  [[nodiscard]] static Result<std::unique_ptr<TableSwitch>> make(
      const Context& context, Ledger& ledger, ScenarioWatch::TellTimes tell_times,
      std::function<void(std::size_t table)> show);

  /// Activations that are nominally released at `nominal_ns` of CLOCK_MONOTONIC are about to be, or those
  /// that were in part: gives them their table. Never waits.
  void at_release(std::int64_t nominal_ns);
  /// After that: whether activations of that nominal release are left out, since a change drains.
  [[nodiscard]] bool leaves_out(std::int64_t nominal_ns) const {
    thread_.check();
    return nominal_ns >= drains_from_ns_ && nominal_ns < drains_until_ns_;
  }
  /// The next thread that calls is another one; the caller orders the two.
  void give_away() { thread_.give_away(); }

  /// No job runs any more: looks for the last time, and ends the watch. Idempotent.
  void stop_watch();
  /// Adds scenarios, changes, and what was outside of every scenario. After the last release has ended, and the watch.
  void report(RunReport& into);

 private:
  TableSwitch(const Context& context, Ledger& ledger, std::unique_ptr<ScenarioWatch> watch,
              std::function<void(std::size_t table)> show);
  void give_table(std::int64_t nominal_ns);
  void put(std::uint64_t from_us, int table);
  std::int64_t change_table(std::uint64_t from_us, const Choice& to, bool in_time);
  void change_scenario(std::int64_t since_ns, const Choice& to);
  void tell(SwitchReport change, const Choice& choice);
  [[nodiscard]] bool is_news(const Choice& choice, int from);

  OneThread thread_;
  const Context& context_;
  Ledger& ledger_;
  const Tables& tables_;
  const std::unique_ptr<ScenarioWatch> watch_;
  const std::function<void(std::size_t table)> show_;
  int table_ = 0;                 ///< in force
  int scenario_ = 0;              ///< the one that was told
  int lost_ = -1;                 ///< the XPU that was last told to be lost
  bool told_outside_ = false;     ///< what was told last is that no scenario allows what was seen
  std::int64_t newest_ns_ = 0;    ///< latest nominal release so far
  std::int64_t settled_ns_ = 0;   ///< from then on another change is certified
  std::int64_t released_ns_ = 0;  ///< when the last one that has a table got it
  std::vector<std::vector<std::int64_t>> drains_us_;       ///< [from][to]; 0: it does not drain
  std::int64_t drains_from_ns_ = 0, drains_until_ns_ = 0;  ///< what is released there is left out
  std::deque<SwitchReport> switches_;
  std::uint64_t num_switches_ = 0;
};

}  // namespace xauto::runtime

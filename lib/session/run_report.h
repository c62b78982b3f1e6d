// SPDX-License-Identifier: Apache-2.0
// What the app tells of a run when it is over, and its way to the tool as JSON.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "session/account.h"
#include "session/distribution.h"

namespace xauto::runtime {

/// What became of one release of the sensors.
struct ReleaseRecord {
  std::uint64_t sequence = 0;
  std::int64_t origin_ns = 0;
  std::int64_t latency_us = -1;  ///< until the last sink module was done; -1: dropped somewhere
};

struct ModuleReport {
  std::string name;
  bool sink = false;
  std::uint64_t activations = 0, failed = 0, dropped = 0;
  std::uint64_t off = 0;      ///< releases in whose table it is off
  std::uint64_t skipped = 0;  ///< those that it, or a module before it, skipped as it was told
  Distribution latencies_us;  ///< sinks: origin to done, per activation
  /// Of a run that gave up: what was released for it and has no result, neither as done nor as lost.
  std::uint64_t unended = 0;
};

/// An XNode with limits; see runtime/stopwatch.h for what is timed.
struct XNodeReport {
  std::string name;
  /// 0: none; wcet_us: Limits::wcet_ns, with tables none: it depends on the scenario.
  std::int64_t budget_us = 0, wcet_us = 0, hang_us = 0;
  /// over_wcet with tables: longer than what any scenario in force covered.
  std::uint64_t jobs = 0, overruns = 0, over_wcet = 0, hangs = 0;
  std::int64_t longest_us = 0;
  std::int64_t over_us = 0;  ///< the most by which one outran its WCET
  std::string module = {};
  /// Jobs past their WCET that had not ended when the run was over, and for how long the longest had run. They
  /// are in none of the counts above.
  std::uint64_t unended = 0;
  std::int64_t unended_us = 0;
};
inline constexpr std::size_t kKeptReleases = 65'536;

/// What suspending work on a real XPU cost, by the calls of its driver.
struct PreemptionReport {
  std::string xpu;
  std::uint64_t suspensions = 0;
  std::int64_t suspend_us = 0, resume_us = 0;  ///< the longest
  std::int64_t preempt_us = 0;                 ///< what the platform says of both
};

/// A scenario of a run with tables.
struct ScenarioReport {
  std::string name, table;
  std::uint64_t releases = 0;  ///< under it
};

/// Another scenario counts from a release on.
struct SwitchReport {
  std::uint64_t release = 0;  ///< the first one of it
  std::string from, to;       ///< scenarios
  std::string table;          ///< which that release has
  std::string why;            ///< runtime::Why
  std::string detail;         ///< the job that was the reason, for people; empty: none was
  std::int64_t held_us = 0;   ///< nothing was released for so long, while it drained
  /// The result that met the change and was nearest to its claim, and of which chain it was; -1: there was none.
  std::int64_t spanned_us = -1;
  std::optional<std::int64_t> worst_case_us;  ///< of it
  std::string chain = {};
};
inline constexpr std::size_t kKeptSwitches = 4096;

/// What one host's part read of an XNode of another host (parts/crossing_reader.h).
struct CrossingReport {
  std::string xnode, from, to;
  std::int64_t x_us = 0;
  std::uint64_t messages = 0;   ///< that were here by their key + X
  std::int64_t longest_us = 0;  ///< of these: from the key, by the reader's clock
  std::uint64_t lost = 0;       ///< that were not
  std::uint64_t late = 0;       ///< of these: they came later, by up to latest_us
  std::int64_t latest_us = 0;
  std::uint64_t twice = 0,
                refused =
                    0;  ///< thrown away: came twice; are of no release that is due, or malformed
  std::uint64_t other_runs = 0;
};

/// Jobs that started before their planned start (runtime/early_start.h), and by how much together.
struct EarlyStartReport {
  bool on = false;  ///< it may happen in this run
  std::uint64_t jobs = 0;
  std::int64_t sum_us = 0;
};

struct RunReport {
  bool complete = false;                ///< every release was accounted for before the end
  std::string note;                     ///< why not, or what was done differently; for people
  std::vector<ReleaseRecord> releases;  ///< of an app of one rate: the last kKeptReleases
  /// Of all; lost are those without a result, also where a run gave up.
  std::uint64_t num_releases = 0, lost_releases = 0;
  Distribution latencies_us;  ///< of all that were not lost
  std::vector<ModuleReport> modules;
  std::vector<XNodeReport> xnodes;  ///< those with limits
  Account account;                  ///< chains, claims and whether they were kept
  EarlyStartReport early_starts;
  std::vector<CrossingReport> crossings;      ///< of one host's part
  std::vector<PreemptionReport> preemptions;  ///< of real XPUs on which work was suspended
  std::vector<std::string> lost_coordinators;
  std::vector<std::string> died;  ///< modules whose process ended before its time, each time
  std::uint64_t deadline_misses = 0;
  /// Of a run with tables; empty of others. The last kKeptSwitches of `num_switches`.
  std::vector<ScenarioReport> scenarios;
  std::vector<SwitchReport> switches;
  std::uint64_t num_switches = 0;
  bool several_rates = false;   ///< there are no releases to count, but each sensor's
  std::string recording_error;  ///< why the recording is not whole; empty: it is, or there is none
};

/// The answer in Mode::kRun; kDescribe answers an AppSpec without WCETs, kProfile a profile.json.
/// Errors of any mode: {"error": {...}}.
[[nodiscard]] std::string to_json(const RunReport& report);
[[nodiscard]] Result<RunReport> parse_run_report(const std::string& text);
[[nodiscard]] std::string error_to_json(const Error& error);

}  // namespace xauto::runtime

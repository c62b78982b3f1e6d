// SPDX-License-Identifier: Apache-2.0
// Of a run with tables: what tables.json claims beside what was measured, for whoever reports it (the
// tool, App::run).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "session/run_report.h"

namespace xauto {
class Json;
}

namespace xauto::runtime {

/// What was longer than its scenario, or the change that it met, claims.
struct TableClaims {
  const char* scope = nullptr;        ///< what the worst cases are of
  std::vector<std::string> exceeded;  ///< a line for each chain
  std::vector<std::string> broken;    ///< assumptions that this run broke, a line each
};
/// `one_at_a_time`: as the app's.
[[nodiscard]] TableClaims table_claims_of(const RunReport& report, bool one_at_a_time);

/// Of what met changes: `us` of `worst_us` is nearer to its worst case than `than_us` of `than_worst_us`, or
/// beyond it by more. Of what nothing is claimed (worst_us 0) the longer one, and none is near.
[[nodiscard]] bool nearer(std::int64_t us, std::int64_t worst_us, std::int64_t than_us,
                          std::int64_t than_worst_us);
/// The nearest of the report's changes; null: none was met by anything that something is claimed of.
[[nodiscard]] const SwitchReport* nearest(const RunReport& report);
/// "of what met a change the nearest to its worst case, a result of 'x', took 31.20 ms of 40.00 ms ('a' to 'b')".
/// `chain`: whose result it is. `mark`: before the worst case.
[[nodiscard]] std::string words_of_nearest(const std::string& chain, std::int64_t us,
                                           std::int64_t worst_us, const std::string& from,
                                           const std::string& to, const char* mark = "");

/// What died of the run's processes, a line each.
[[nodiscard]] std::vector<std::string> words_of_deaths(const RunReport& report);

/// What did not end: jobs past their WCET or their hang limit, and the run itself; a line each.
[[nodiscard]] std::vector<std::string> words_of_unended(const RunReport& report);
/// "XNode 'x' of XModule 'm' has run for 31.20 ms and has not ended; its WCET is 20.00 ms".
[[nodiscard]] std::string words_of_unended(const std::string& xnode, const std::string& module,
                                           std::uint64_t jobs, std::int64_t us,
                                           std::int64_t wcet_us);
/// "1 job of XNode 'x' of XModule 'm' ran past its hang limit".
[[nodiscard]] std::string words_of_hangs(const std::string& xnode, const std::string& module,
                                         std::uint64_t jobs);

/// "preemption failed 3 times on gpu0: the work of XNode 'x' was not suspended"; and of resuming; a line each.
[[nodiscard]] std::vector<std::string> words_of(const FailedPreemptionReport& failed);

/// Releases that met in an app that releases one at a time; empty: none did.
[[nodiscard]] std::string words_of_overlaps(std::uint64_t overlapping, std::uint64_t releases);
/// Jobs longer than their WCET, of tables longer than their scenario's; empty: there was none.
[[nodiscard]] std::string words_of_overruns(const RunReport& report);

/// Of a run by tables, what breaks its claims.
[[nodiscard]] std::string words_of_unproven(std::uint64_t switches);
[[nodiscard]] std::string words_of_unsettled(std::uint64_t releases);

/// Adds the members `worst_case_of`, `worst_case_exceeded`, `worst_case_broken`, `scenarios`, `switches`
/// and `num_switches` (docs/formats.md, report.json).
void add_tables(const RunReport& report, const TableClaims& claims, Json& into);

}  // namespace xauto::runtime

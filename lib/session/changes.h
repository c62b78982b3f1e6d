// SPDX-License-Identifier: Apache-2.0
// Of a run with tables: its changes of the scenario, and what met them.
#pragma once

#include <cstdint>
#include <string>

#include "session/run_report.h"

namespace xauto {
class Json;
}

namespace xauto::runtime {

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

/// Adds the members `scenarios`, `switches` and `num_switches` (docs/formats.md, report.json).
void add_changes(const RunReport& report, Json& into);

}  // namespace xauto::runtime

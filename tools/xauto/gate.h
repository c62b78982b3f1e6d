// SPDX-License-Identifier: Apache-2.0
// `xauto run --fail-on`: a run as a gate in CI.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "xauto/run_app.h"

namespace xauto::cli {

/// The words of --fail-on.
inline const std::vector<std::string> kGateWords = {"miss", "lost", "hang", "restart", "claim"};

/// Releases without a result; with several rates there are no releases of the whole: of each module
/// whose results the app is there for, its own.
[[nodiscard]] std::uint64_t lost_results(const runtime::RunReport& report);

/// One word, and what of it the run had.
struct GateCount {
  std::string word;
  std::uint64_t count = 0;
  std::string what;  ///< for people: "3 results missed their deadline"
};

/// Errors: a word that nothing in the app could ever trip, since it would pass whatever happens.
[[nodiscard]] Status check_gate(const RunFlags& flags, const PolicyRun& run);
/// [word of --fail-on]
[[nodiscard]] std::vector<GateCount> gate_of(const RunFlags& flags, const PolicyRun& run);

}  // namespace xauto::cli

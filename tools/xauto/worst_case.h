// SPDX-License-Identifier: Apache-2.0
// The policy's certified worst case beside what was measured: does this run keep what the
// certificate takes for granted (kWorstCaseScope)? A longer release never stands beside an
// unqualified claim.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "xauto/run_app.h"

namespace xauto::cli {

struct WorstCase {
  std::int64_t us = 0;
  std::vector<std::string> broken;  ///< assumptions that this run broke, a line each; empty: none
  bool exceeded = false;            ///< a release took longer
};

/// Nullopt where nothing was claimed: no certificate, or nobody scheduled by the policy.
[[nodiscard]] std::optional<WorstCase> worst_case_of(const RunFlags& flags, const PolicyRun& run);

/// One line, without its end.
[[nodiscard]] std::string to_string(const WorstCase& worst);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// The policy's certified worst case beside what was measured: does this run keep what the
// certificate takes for granted (kWorstCaseScope)? A longer release never stands beside an
// unqualified claim. Of an app of version 2 the same for each of its chains (kKeyScope).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "session/table_claims.h"

#include "xauto/run_app.h"
#include "xauto/verdict.h"

namespace xauto::cli {

struct WorstCase {
  std::int64_t us = 0;
  std::vector<std::string> broken;  ///< assumptions that this run broke, a line each; empty: none
  bool exceeded = false;            ///< a release took longer
  std::vector<std::string> taken = {};  ///< who took time away, if it did and nothing was broken
};

/// Nullopt where nothing was claimed: no certificate, or nobody scheduled by the policy.
[[nodiscard]] std::optional<WorstCase> worst_case_of(const PolicyRun& run);

/// What the policy claims of a chain, and what its releases took.
struct ChainClaimed {
  ChainClaim claim;
  std::int64_t max_us = 0;
  std::size_t count = 0;  ///< releases; 0: none was measured
  bool exceeded = false;  ///< by more than the emulator's own part
};
struct KeyClaims {
  std::vector<ChainClaimed> chains;     ///< in the order of RunReport::routes
  std::vector<std::string> broken;      ///< as WorstCase
  bool exceeded = false;                ///< one of them is
  std::vector<std::string> taken = {};  ///< as WorstCase
};
/// Whether it goes by keys that are not certified: it is held against nothing, and says so.
[[nodiscard]] bool claims_nothing(const PolicyRun& run);
inline constexpr const char* kClaimsNothing =
    "nothing is claimed: the policy is not certified (`xauto solve` says what would make it so)";
/// What the run's policy claims of the chains of an app of version 2; of tables largest_claims(). Empty:
/// it has no keys.
[[nodiscard]] std::vector<ChainClaim> claimed_chains(const PolicyRun& run);
/// Nullopt where nothing was claimed.
[[nodiscard]] std::optional<KeyClaims> key_claims_of(const RunFlags& flags, const PolicyRun& run);
[[nodiscard]] std::string to_string(const KeyClaims& claims, Layout layout = Layout::kLine);

/// Nullopt of runs without tables.
[[nodiscard]] std::optional<runtime::TableClaims> table_claims_of(const RunFlags& flags,
                                                                  const PolicyRun& run);
[[nodiscard]] std::string to_string(const runtime::TableClaims& claims,
                                    const std::vector<std::string>& taken,
                                    Layout layout = Layout::kLine);

[[nodiscard]] std::string to_string(const WorstCase& worst, Layout layout = Layout::kLine);

}  // namespace xauto::cli

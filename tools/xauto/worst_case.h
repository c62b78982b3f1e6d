// SPDX-License-Identifier: Apache-2.0
// Each chain's certified worst case beside what was measured: does this run keep what the
// certificate takes for granted (scope_of)? A longer release never stands beside an
// unqualified claim.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "session/table_claims.h"

#include "xauto/run_app.h"
#include "xauto/verdict.h"

namespace xauto::cli {

/// What the policy claims of a chain, and what its releases took.
struct ChainClaimed {
  ChainClaim claim;
  std::int64_t max_us = 0;
  std::size_t count = 0;  ///< releases; 0: none was measured
  bool exceeded = false;  ///< by more than the emulator's own part
};
struct KeyClaims {
  std::vector<ChainClaimed> chains;  ///< in the order of RunReport::routes
  const char* scope = "";            ///< what is claimed
  std::vector<std::string> broken;   ///< assumptions that this run broke, a line each; empty: none
  bool exceeded = false;             ///< one of them is
  std::vector<std::string> taken = {};  ///< who took time away, if it did and nothing was broken
};
/// Whether it goes by keys that are not certified: it is held against nothing, and says so.
[[nodiscard]] bool claims_nothing(const PolicyRun& run);
inline constexpr const char* kClaimsNothing =
    "nothing is claimed: the policy is not certified (`xauto solve` says what would make it so)";
/// What the run's policy claims of chains; of tables largest_claims(). Empty:
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

}  // namespace xauto::cli

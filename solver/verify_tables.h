// SPDX-License-Identifier: Apache-2.0
// Do tables tell the truth? Every claim of tables.json again, with the checker's own code
// (verify.h): each scenario's lower bound, the worst case of the table that serves it, and that of a
// release during which one scenario takes the place of another. Of tables of keys (keys/check.h,
// keys/check_handover.h): each table at its envelope, and the change from each table to each other.
#pragma once

#include <string>
#include <vector>

#include "model/tables.h"
#include "solver/verify.h"

namespace xauto::solver {

struct TablesVerification {
  /// As of Verification, each with its scenario's name before it.
  std::vector<std::string> lies, shown, taken;
  double worst_regret = 0;  ///< of what is claimed
  [[nodiscard]] bool truthful() const { return lies.empty(); }
};

/// `options` of each scenario's check.
[[nodiscard]] TablesVerification verify_tables(const AppSpec& app, const Platform& platform,
                                               const Tables& tables,
                                               const VerifyOptions& options = {});

}  // namespace xauto::solver

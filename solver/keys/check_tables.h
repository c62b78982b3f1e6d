// SPDX-License-Identifier: Apache-2.0
// Do tables tell the truth? Every claim of tables.json again: each table at its envelope and what each of its scenarios
// has beyond that (check.h), and the change from each table to each other (check_handover.h). Shares no code with the
// search.
#pragma once

#include <string>
#include <vector>

#include "model/tables.h"

namespace xauto::solver::keys {

struct TablesReport {
  std::vector<std::string> lies;   ///< what is claimed, and what follows instead
  std::vector<std::string> shown;  ///< what was derived
  std::vector<std::string> taken;  ///< claimed, neither shown nor false
  double worst_regret = 0;         ///< of what is claimed
  [[nodiscard]] bool truthful() const { return lies.empty(); }
};

[[nodiscard]] TablesReport examine_tables(const AppSpec& app, const Platform& platform,
                                          const Tables& tables);

}  // namespace xauto::solver::keys

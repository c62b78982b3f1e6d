// SPDX-License-Identifier: Apache-2.0
// What would make a policy certified, for an app of which nothing is: single changes, each tried with a search of its
// own. What is told was certified; what is not told is not proven to be in vain.
#pragma once

#include <string>
#include <vector>

#include "model/app.h"
#include "model/json_value.h"
#include "model/platform.h"
#include "solver/keys/uncertified.h"

namespace xauto::cli {

struct Remedy {
  std::string change;  ///< "camera at most 24 Hz (every 41666 us or more)"
  Json what;           ///< the same for programs
  bool late = false;   ///< what was certified with it misses a deadline
};

/// Less margin, as `found` says; a WCET above twice what is usual (rare_wcets.h) as it usually is, or all of them; one
/// source slower, by the least of some factors that helps. `options.time_limit_s` is for all of them.
[[nodiscard]] std::vector<Remedy> remedies(const AppSpec& app, const Platform& platform,
                                           const solver::keys::Uncertified& found,
                                           const solver::keys::Options& options);

}  // namespace xauto::cli

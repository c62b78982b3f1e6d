// SPDX-License-Identifier: Apache-2.0
// Handover: how long a chain takes at most while a run goes from one table of keys to another, both of
// them certified, without a pause (docs/keys.md, theorem 8).
//
// For each instant S of a hyperperiod at which it may go over, and each instant t shortly before at
// which jobs may have begun to take longer, the jobs of both tables are walked by their keys: by when
// is each ready, by when done, until all are in time again. Where clocks share XPUs nothing follows.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "solver/keys/problem.h"
#include "solver/keys/windows.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// The three problems are of one app, and differ in their WCETs, and in transfers between types that an
/// XNode may have in one of them alone.
struct HandoverInput {
  const Problem& now;                 ///< at the envelope of the table that is in force
  const Problem& then;                ///< of the next one
  const Problem& both;                ///< of each WCET the larger one
  std::vector<int> from_xpu, to_xpu;  ///< [xnode]
  Windows from, to;                   ///< certify() has passed them
  Tick notice = 0;                    ///< from the first job that takes longer, until it counts
};

struct HandoverBound {
  std::vector<Tick> worst;  ///< [chain]; kNoTick: nothing follows
  Tick settles = 0;         ///< after S: no job is late any more, of the clocks that were looked at
  std::vector<std::string> why_not;  ///< for which clocks nothing follows
};

/// Jobs of all walks together, beyond which nothing follows.
inline constexpr std::int64_t kMostWalked = 20'000'000;

[[nodiscard]] HandoverBound bound_handover(const HandoverInput& tables,
                                           std::int64_t most_jobs = kMostWalked,
                                           const Until& until = {});

}  // namespace xauto::solver::keys

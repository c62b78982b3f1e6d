// SPDX-License-Identifier: Apache-2.0
// What a change of tables may cost, derived again from apps, platform and keys alone
// (docs/keys.md, theorem 8). Shares no code with the solver's handover.cc.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::solver::keys {

/// One app under three sets of WCETs: p's envelope, q's, and the larger of both.
struct TwoTables {
  const AppSpec& app_from;
  const AppSpec& app_to;
  const AppSpec& app_both;
  const Platform& platform;
  const Policy& from;  ///< p; its certificate holds (check.h)
  const Policy& to;    ///< q, likewise
  std::int64_t notice_us = 0;
};

struct HandoverProof {
  /// [chain] rounded up; nullopt: nothing follows for it.
  std::vector<std::optional<std::int64_t>> worst_case_us;
  /// By then after S no job is late any more, of the clocks for which that follows; rounded up.
  std::int64_t settles_us = 0;
  std::vector<std::int64_t> chain_settles_us;  ///< [chain] the same, of the clocks that it passes
  std::vector<std::string> why_not;            ///< for whom nothing follows, a line each
};

/// kInvalid: the input makes no sense. `most_jobs`: of all walks together; beyond them nothing follows.
[[nodiscard]] Result<HandoverProof> derive_handover(const TwoTables& tables,
                                                    std::int64_t most_jobs = 50'000'000);

}  // namespace xauto::solver::keys

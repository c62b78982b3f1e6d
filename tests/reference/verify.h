// SPDX-License-Identifier: Apache-2.0
// Does a policy tell the truth? Re-derives every number of policy.json from app.json and
// platform.json. Shares no code with the solver: neither Problem nor simulator nor bounds, only the
// value types.
//
// What a finished check means is in the answer in words: `lies` are contradictions, each with the
// number that is right; `shown` is what was re-derived; `taken` is what was only tried to refute,
// and how.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "model/priority_plan.h"
#include "solver/objectives.h"

namespace xauto::solver {

struct VerifyOptions {
  std::int64_t proof_nodes = 2'000'000;  ///< budget of the proof that lower_bound_us holds
  std::int64_t schedules = 100'000;      ///< schedules tried against lower_bound_us
  std::uint64_t seed = 1;
  Objectives asked;  ///< pins, forbids and groups the policy must keep; chains it may miss
  /// Claimed elsewhere for all policies of this app, e.g. by `solve`; held against this one, too.
  std::optional<std::int64_t> other_bound_us;
};

struct Verification {
  std::vector<std::string> lies;
  std::vector<std::string> shown;
  std::vector<std::string> taken;
  std::vector<std::string> missed;  ///< deadlines that the policy does not meet: no lie, but a no
  std::int64_t latency_us = 0;      ///< what the rule of problem.h gives
  std::int64_t own_bound_us = 0;    ///< proven here, <= any schedule
  std::int64_t best_found_us = 0;   ///< the shortest schedule that the check constructed
  bool bound_proven = false;        ///< lower_bound_us re-proven
  /// A policy that takes less than what is claimed as a bound on all policies: in words, with both
  /// numbers. Whoever claimed it has proven something false. Empty: none was met.
  std::string counterexample;

  [[nodiscard]] bool truthful() const { return lies.empty(); }
};

[[nodiscard]] Verification verify(const AppSpec& app, const Platform& platform,
                                  const PriorityPlan& policy, const VerifyOptions& options = {});

}  // namespace xauto::solver

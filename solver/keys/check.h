// SPDX-License-Identifier: Apache-2.0
// Does a policy of keys hold for ever? Derives it again from app, platform and policy alone:
// every window, on every XPU a schedule or a demand curve, and each chain's worst case. Shares no
// code with the search. The theory and its proofs: docs/keys-check.md.
//
// A lie is an Error, with XNode, activation, XPU and instant.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/demand.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::solver::keys {

/// Why every job on one XPU ends by its key.
struct XpuProof {
  std::string xpu;
  /// "schedule", "demand bound", "demand bound and blocking", or "no job".
  std::string kind;
  double load = 0;        ///< of its time, with the preemptions that are charged
  std::int64_t jobs = 0;  ///< in `repeats_us`, of all clocks
  std::int64_t charged = 0;
  double repeats_us = 0;  ///< the pattern that was looked at; the longest one, of several clocks
  /// Tightest point: what has its window in an interval of length `length_us` needs `demand_us` of
  /// it. It ends with the key of this job.
  std::string xnode;
  std::int64_t activation = 0;
  double length_us = 0, demand_us = 0, slack_us = 0;
};

struct ChainProof {
  std::string name;
  std::int64_t derived_us = 0;  ///< worst case that follows, rounded up
  std::int64_t claimed_us = 0;
  std::int64_t own_bound_us = 0;  ///< no policy is shorter: least WCETs along the worst path
  std::int64_t claimed_bound_us = 0;
  /// derived_us and claimed_us of an urgent release; nullopt: its source has none.
  std::optional<std::int64_t> urgent_us = {}, claimed_urgent_us = {};
  std::vector<std::string> path;  ///< source, then where it enters and leaves each component
  std::optional<std::int64_t> deadline_us;
  [[nodiscard]] bool late() const { return deadline_us && derived_us > *deadline_us; }
};

/// After the nominal release of the job's component.
struct JobWindow {
  double ready_us = 0;  ///< by then, if all others keep their keys
  double key_us = 0;
};

struct CheckReport {
  std::vector<XpuProof> xpus;  ///< [xpu]; `kind` empty: a lie says what is not shown
  std::vector<std::vector<JobWindow>> windows;  ///< [xnode][activation mod size]
  std::vector<ChainProof> chains;               ///< of the app's, up to what could not be derived
  /// Each says what is claimed, and what follows instead. Where a window is false nothing more is derived.
  std::vector<Error> lies;
  /// Claimed, neither shown nor false: lower bounds above the check's own; what a preemption costs where nobody has
  /// measured it.
  std::vector<std::string> taken;
};

/// All that is false, shown, or taken on trust. kInvalid: the input makes no sense, or the policy is not certified and
/// claims nothing that could follow. `beside`: others' jobs, as their demands say, are on the XPUs, too; and so much of
/// each is left (docs/keys.md, "Apps compose").
[[nodiscard]] Result<CheckReport> examine(const AppSpec& app, const Platform& platform,
                                          const Policy& policy, const Beside& beside = {});
/// Refuses what lies, with the first lie, which is kInfeasible.
[[nodiscard]] Result<CheckReport> check(const AppSpec& app, const Platform& platform,
                                        const Policy& policy, const Beside& beside = {});

/// What the policy, which check() takes, asks of each XPU. kInvalid: its sources have no rate, so that no demand bounds
/// what it takes; its times are too long for the file.
[[nodiscard]] Result<Demand> demand_of(const AppSpec& app, const Platform& platform,
                                       const Policy& policy);

/// What an XNode asks of its XPU where its app is not trusted: nothing is known of it but this. In ns.
struct SporadicNeed {
  int xnode = 0, xpu = 0;
  std::int64_t period_ns = 0;   ///< between two of its releases, at least
  std::int64_t window_ns = 0;   ///< from when a job is ready to its key: of the shortest
  std::int64_t longest_ns = 0;  ///< from its earliest start to its key: of the longest
  std::int64_t work_ns = 0;     ///< WCET, and what a preemption costs
};
/// Of each XNode of a policy that check() takes. kInvalid: as demand_of; or releases may be urgent.
[[nodiscard]] Result<std::vector<SporadicNeed>> sporadic_needs_of(const AppSpec& app,
                                                                  const Platform& platform,
                                                                  const Policy& policy);

/// Whether the last of these apps can come to the others: on each XPU that it uses, and be it alone there, all demands
/// together have a proof. Then every claim of each of them stands (docs/keys.md, "Apps compose"). kInfeasible: on which
/// XPU they do not fit, and by how much; kInvalid: they do not agree on what that XPU is.
[[nodiscard]] Status check_together(const std::vector<Demand>& demands);

/// What all together leave of an XPU that each of them has: the largest reserve in whole percent, 0 to kMaxReservePct, with
/// which they still have a proof (docs/keys.md, "A reserve"). So, where each job pays for a preemption, the demands D and
/// the longest blocking B are at most (1 - slack) t in every interval t; newcomers whose own demands are at most slack t
/// find room as it is said there. kInfeasible: they have no proof without one.
[[nodiscard]] Result<int> slack_together(const std::vector<Demand>& demands);

/// What a policy states that is not certified: it is for this app, each XNode is where it can run, and its order leaves
/// a way through. Nothing of times.
[[nodiscard]] Status check_places(const AppSpec& app, const Platform& platform,
                                  const Policy& policy);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Demand: what a policy of keys asks of each XPU, without a name of what is executed there. It is all that somebody
// else has to know for his own policy to hold beside it: docs/keys.md, "Apps compose". File: demand.json.
// Value types; `validate` says whether they make sense, and every reader calls it.
#pragma once

#include <cstdint>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"

namespace xauto {

/// One job of a sequence, in ticks. All but `release` counts from its release, in real time.
struct DemandJob {
  std::int64_t release = 0;  ///< on the clock's grid, in [0, period)
  std::int64_t ready = 0;    ///< by then
  std::int64_t start = 0;  ///< not before; below 0 for what may be urgent: no phase is known of it
  std::int64_t key = 0;    ///< it ends by then
  std::int64_t work = 0;   ///< WCET, with what a preemption costs where it is `charged`
  bool charged = false;
  bool operator==(const DemandJob&) const = default;
};

/// Jobs that keep their phases to each other, again and again. No phase is known between two sequences.
struct DemandSequence {
  std::int64_t period = 0;  ///< ticks
  std::int64_t ppm = 0;     ///< how much faster or slower the clock of its releases may be
  /// Urgent releases: each job is at most once in any interval, and may be ready by up to `slip` later.
  bool once = false;
  std::int64_t slip = 0;
  std::vector<DemandJob> jobs;
  bool operator==(const DemandSequence&) const = default;
};

struct DemandOnXpu {
  Xpu xpu;  ///< its id, whether it preempts, at what cost, on how many levels; nothing else is set
  std::vector<DemandSequence> sequences;
  bool operator==(const DemandOnXpu&) const = default;
};

struct Demand {
  std::int64_t ticks_per_us = 1;
  std::vector<DemandOnXpu> xpus;  ///< that have jobs
  bool operator==(const Demand&) const = default;
};

/// Whom a policy has to hold beside.
struct Beside {
  std::vector<Demand> demands;  ///< each of an app, or of several that were tested together
  int reserve_pct = 0;          ///< of each XPU, for those that are not known yet
  [[nodiscard]] bool nobody() const { return demands.empty() && reserve_pct == 0; }
};

inline constexpr std::size_t kMaxDemandSequences = 4096;  ///< of one XPU
inline constexpr std::size_t kMaxDemandJobs = 400'000;    ///< of one sequence
inline constexpr std::int64_t kMaxDemandTicks = std::int64_t{1} << 53;
inline constexpr int kMaxReservePct = 90;

/// Of the time of its XPU, what its jobs ask for in the long run, with the preemptions that they are charged: work per
/// period. Urgent releases take the place of others and are not counted.
[[nodiscard]] double utilisation(const DemandOnXpu& on);
/// kInvalid: its sources have no rate. It releases as soon as it can, so no demand bounds it.
[[nodiscard]] Status has_demand(const AppSpec& app);
/// XPUs and times as above, each XPU once; ready < key, start <= ready, work from 1.
[[nodiscard]] Status validate(const Demand& demand);
/// Its XPUs are those of the platform: there, and what preempts, or costs, as here.
[[nodiscard]] Status validate_on(const Demand& demand, const Platform& platform);

}  // namespace xauto

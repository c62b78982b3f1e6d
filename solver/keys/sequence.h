// SPDX-License-Identifier: Apache-2.0
// An app that releases one at a time, by keys that say who goes first on each XPU. The same sequence at other WCETs has
// other keys, and what runs by the one runs by the other: a job's key is compared on its XPU alone, and all releases are
// over when the next one comes. So one table has a worst case of its own in each scenario (docs/keys.md, "Claims of a
// scenario").
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "model/policy.h"
#include "model/tables.h"
#include "solver/keys/problem.h"

namespace xauto::solver::keys {

/// Sets the keys with which each XPU does its XNodes one after the other in `sequence`, a permutation of all in which no
/// one comes before what it waits for: each ends when its longest way is over, and none starts before its hold.
void set_sequence_keys(const Problem& problem, const std::vector<int>& sequence, Policy& policy);

/// The XNodes by their keys; nullopt: two on one XPU have the same, so that the keys do not say who goes first.
[[nodiscard]] std::optional<std::vector<int>> sequence_of(const Policy& policy);

/// [chain of app_with()] of a release within the WCETs of `scenario`, in the sequence of table `table`. nullopt: nothing
/// follows from that, since a job without an order pair may start before one that has a smaller key.
[[nodiscard]] std::optional<std::vector<std::int64_t>> sequence_claims(const Tables& tables,
                                                                       std::size_t table,
                                                                       const AppSpec& app,
                                                                       const Platform& platform,
                                                                       const Scenario& scenario);

/// Sets what each scenario claims, and what follows from that (set_figures): what its table does, or, of an app that
/// releases one at a time, what its own sequence does, where that is less.
void set_claims(Tables& tables, const AppSpec& app, const Platform& platform);

/// Of an app that releases one at a time: of the release that meets a change, from each table to each other one.
[[nodiscard]] std::vector<Handover> releases_across(const Tables& tables, const AppSpec& app,
                                                    const Platform& platform);

}  // namespace xauto::solver::keys

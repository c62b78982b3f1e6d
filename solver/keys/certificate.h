// SPDX-License-Identifier: Apache-2.0
// Certificate: that every XPU, taken alone, executes its jobs in their windows. With
// docs/keys.md's theorem every job then ends by its key. Nothing of the search is believed:
// windows and charges are derived from keys and holds.
#pragma once

#include <string>
#include <vector>

#include "solver/keys/alone.h"
#include "solver/keys/demand.h"
#include "solver/keys/problem.h"
#include "solver/keys/windows.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// XPUs that serve more than one domain, or urgent releases, given who is where: these need the
/// demand bound.
[[nodiscard]] std::vector<char> shared_xpus(const Problem& problem, const std::vector<int>& xpu);

/// How much earlier than its d a job has to be done in nominal time on an XPU of one domain whose
/// clock may drift, with windows not deeper than `deepest`. The clock moves two releases that are
/// |Delta| apart by ppm * |Delta| against a and d, which are real times, and |Delta| is at most the
/// length of the interval + deepest: work / (1 - ppm) pays for the first, this for the second.
[[nodiscard]] Tick drift_pad(Tick deepest, std::int64_t ppm);

/// Activation n of the XNode, as it is tested on an XPU of one domain. `pad`: drift_pad.
[[nodiscard]] LaidJob laid(const Problem& problem, const Windows& w, int xnode, int n, int xpu,
                           bool pays, Tick blocked_by, Tick pad);

/// One XPU by the demand bound, whatever domains it serves. `w`, `u` (urgent releases) and `charges`
/// are derived.
[[nodiscard]] bool shared_fits(const Problem& problem, int xpu, const std::vector<int>& xpus,
                               const Windows& w, const Windows& u, const Charges& charges,
                               Tightest* tightest = nullptr);

/// One XPU, `shared` (shared_xpus) or not. `w`, `u` and its `charges` are derived.
[[nodiscard]] bool certify_xpu(const Problem& problem, int xpu, const std::vector<int>& xpus,
                               bool shared, const Windows& w, const Windows& u,
                               const Charges& charges, std::string* why = nullptr);

/// d and hold of `w` are given (by slot), the rest is derived, WCETs that contention counts too. False, with `why` (may be null): an
/// XPU and what is wrong, or that the time is over.
[[nodiscard]] bool certify(const Problem& problem, const std::vector<int>& xpu, Windows& w,
                           std::string* why = nullptr, const Until& until = {});

}  // namespace xauto::solver::keys

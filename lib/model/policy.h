// SPDX-License-Identifier: Apache-2.0
// Policy: the solver's answer, the runtime's order. File: policy.json.
//
// A job's key is an absolute instant: the nominal release of its component's activation plus
// `key_us`. On an XPU the smaller key is the more urgent. Whoever keeps to that ends each job by its
// key (docs/keys.md).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"

namespace xauto {

/// Where one XNode runs, and by when. Entry j of each array belongs to the activations n of its
/// component with n mod size() = j. Microseconds after that activation's nominal release.
struct Placement {
  int xpu = -1;                            ///< index into Platform::xpus
  std::vector<std::int64_t> key_us;        ///< at least one; the job is done by then
  std::vector<std::int64_t> hold_us = {};  ///< it does not start before; empty: it is not held
  /// Predicted, every job at its WCET; as many as keys, or empty: not known (several clocks).
  std::vector<std::int64_t> start_us = {}, finish_us = {};
  /// What the proof counts for a job. It is there where the XNode states a WCET beside loads on the type of its XPU, and
  /// is from that alone to the longest (contention.h). Not beside `priority`.
  std::optional<std::int64_t> wcet_us = {};
  /// Held, it starts early only when all that it samples of other clocks and that is released before its planned start
  /// has ended. No claim asks for that; it makes chains shorter on an ordinary day (docs/keys.md, "Early start").
  bool reads_all = false;
  /// In place of all these, the same in every release: larger goes first. Of all XNodes, or of none; unique on each
  /// XPU.
  std::optional<std::int64_t> priority = {};
  bool operator==(const Placement&) const = default;
};

struct ChainClaim {
  std::string name;  ///< of AppSpec::chains, same order
  /// Bounds the reduced reaction time: from the nominal release of the source's message to the end
  /// of the first job of the chain's last XNode that knows it or a newer one.
  std::int64_t worst_case_us = 0;
  /// Proven: of no Policy can a shorter worst case be certified by docs/keys.md. Where the
  /// chain enters another clock, executions may stay below it.
  std::int64_t lower_bound_us = 0;
  bool optimal = false;  ///< both are equal
  /// As worst_case_us, of a release that its source marks urgent. There iff the source may.
  std::optional<std::int64_t> urgent_worst_case_us = {};
  bool operator==(const ChainClaim&) const = default;
};

/// A message between hosts: what `from` publishes is on `host`, by that host's clock, at most x_us after the key of
/// `from`. A run watches it.
struct Crossing {
  int from = -1;  ///< index into AppSpec::xnodes
  int host = -1;  ///< index into Platform::hosts, not the one of `from`
  std::int64_t x_us = 0;
  bool operator==(const Crossing&) const = default;
};

/// The best that was found is a policy too where nothing can be certified. Then it only says who goes first: no chain
/// has a claim, and no job is said to end by its key.
struct Policy {
  std::string app;       ///< AppSpec::name
  std::string app_hash;  ///< AppSpec::hash()
  std::string platform;  ///< Platform::name, for people
  std::string method;
  std::vector<Placement> placements;  ///< one per AppSpec::xnodes entry, same order
  std::vector<ChainClaim>
      chains;  ///< one per AppSpec::chains entry, same order; none where it is not certified
  std::int64_t solve_us = 0;
  /// Pairs (u, v) of XNodes on one XPU that are released together (released_together): v of an activation is not
  /// started before u of it has ended. A pair does what an edge does, without a message.
  std::vector<std::pair<int, int>> order = {};
  std::vector<Crossing> crossings = {};  ///< by XNode, then host: those of crossings_of() (hosts.h)
  bool certified = true;                 ///< false: nothing is claimed
  /// It has priorities, and no keys: what baselines have, and what is written by hand. Nothing is claimed of it.
  [[nodiscard]] bool by_priority() const {
    return !placements.empty() && placements.front().priority.has_value();
  }
  bool operator==(const Policy&) const = default;
};

/// What can be said without a schedule. The policy is for this app (name and hash); every XNode is
/// on an XPU of a type that it has an implementation for. Its arrays have one size, which divides
/// its activations per hyperperiod. Each job fits between being ready (hold; a root: offset and
/// jitter; otherwise: its predecessors' keys and the transfers) and its key. Key plus nominal
/// release does not fall from one activation to the next. Order pairs leave a way through, and to keys as edges
/// do. Every chain of the app has a claim; of a policy that is not certified none has, and its keys need no room for WCETs.
[[nodiscard]] Status validate(const Policy& policy, const AppSpec& app, const Platform& platform);

/// [chain] what it claims.
[[nodiscard]] std::vector<std::int64_t> worst_cases(const Policy& policy);

/// By its claims.
[[nodiscard]] bool misses_a_deadline(const Policy& policy, const AppSpec& app);

/// [edge] what its message costs where the policy has both ends, between hosts with its crossing.
[[nodiscard]] std::vector<std::int64_t> transfers_us(const Policy& policy, const AppSpec& app,
                                                     const Platform& platform);

/// Its assignment, for whoever asks only that; with its priorities, or those that come nearest to its keys:
/// on each XPU the smaller first key is the larger priority. Nothing is claimed of them.
[[nodiscard]] PriorityPlan assignment_of(const Policy& keys);
/// Holds in place of the order pairs on XPUs that `of` takes: each v is held until the key of its u. No window, no key
/// and no worst case changes (docs/keys.md, "Order").
[[nodiscard]] Policy held_in_place_of_order(Policy policy, const std::function<bool(int xpu)>& of);
/// A plan's assignment, priorities and order as a policy of `app`, which the plan may know in part only.
[[nodiscard]] Policy by_priorities(const PriorityPlan& plan, const AppSpec& app);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Tables: several policies for one app, and which of them serves which scenario. File: tables.json.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/loss.h"
#include "model/policy.h"
#include "model/priority_plan.h"
#include "model/scenario.h"

namespace xauto {

/// Of a chain that the table does not have, since a module on its way is off (kept_chains).
inline constexpr std::int64_t kNotThere = -1;

/// Certified for its envelope: of each WCET the longest of the scenarios that it serves.
struct Table {
  std::string name;
  /// Keys, holds and order, also of what is off (app_with); XPUs of the whole platform, -1: the XNode's module is
  /// off. Each chain's worst case whichever of its scenarios is in force, and while one of them takes the place of
  /// another; or kNotThere.
  Policy keys;
  Loss loss = {};  ///< none, unless all scenarios that it serves are degraded
  [[nodiscard]] int xpu(std::size_t xnode) const { return keys.placements[xnode].xpu; }
  bool operator==(const Table&) const = default;
};

/// How a scenario is served.
struct Served {
  int table = -1;
  /// [chain] of every execution within the scenario's WCETs, or kNotThere. Where sources have rates it is the table's:
  /// what runs by keys ends by them, however short its jobs are. Of an app that releases one at a time the keys say
  /// who goes first on each XPU; the same sequence has earlier keys at shorter WCETs (sequence_keys).
  std::vector<std::int64_t> chain_worst_us = {};
  /// [chain] proven, as ChainClaim::lower_bound_us, of what the table's loss leaves; or kNotThere.
  std::vector<std::int64_t> chain_bound_us = {};
  std::int64_t worst_case_us = 0;   ///< what chain_objective says of the worst cases
  std::int64_t lower_bound_us = 0;  ///< proven: under this scenario no policy has less of that
  bool operator==(const Served&) const = default;
};

/// A run goes from one table to another without a pause, and each release keeps
/// the one that it has. docs/keys.md, theorem 8.
struct Handover {
  int from = -1, to = -1;  ///< tables
  /// [chain] of every release that meets it, each job within the WCETs of both tables' scenarios;
  /// kNotThere: one of the tables does not have it, and its jobs are in time by settles_us, too;
  /// nullopt: nothing is claimed, and the change drains (drain.h).
  std::vector<std::optional<std::int64_t>> worst_case_us;
  std::int64_t settles_us = 0;  ///< from then on jobs are in time again; not before, the next one
  std::vector<std::string> not_claimed =
      {};  ///< why some chains have none, a line each; for people
  /// Whether it claims something of each chain that both tables have, and the others have settled.
  [[nodiscard]] bool claims_all() const;
  bool operator==(const Handover&) const = default;
};

struct Tables {
  std::string app, app_hash, platform;
  std::vector<Scenario> scenarios;
  std::vector<Table> tables;
  std::vector<Served> serves;  ///< [scenario]
  std::vector<Handover> handovers =
      {};                      ///< all (from, to) of different tables, in that order; or none
  std::int64_t notice_us = 0;  ///< they count on it that a job that takes too long is known by then
  std::int64_t solve_us = 0;
  bool operator==(const Tables&) const = default;

  /// The largest of worst_case_us / lower_bound_us.
  [[nodiscard]] double worst_regret() const;
};

/// Why a scenario counts in a run. Written as a number into traces: append only.
enum class Why : std::uint8_t {
  kStart,    ///< it is the file's first
  kAsked,    ///< people asked for it, or no longer ask for more
  kMachine,  ///< the machine's clocks are those of this scenario
  kOverrun,  ///< a job took longer than the scenario before allows
  kBack,     ///< a dwell long nothing needed more
  kOutside,  ///< no scenario allows what was seen: this one covers most
  kLost,     ///< a job does not return from an XPU, which counts as lost
};
[[nodiscard]] const char* to_string(Why why);  ///< "asked"; of a number beyond them "?"

inline constexpr std::size_t kMaxTables = 100;

/// What a table has to schedule under `scenario`, and on what: app_with() of app_under().
[[nodiscard]] AppSpec app_under(const AppSpec& app, const Scenario& scenario, const Loss& loss);
/// What `table` is certified for: of each WCET the longest of the scenarios that it serves, and what any
/// of them has lost.
[[nodiscard]] Scenario envelope(const Tables& tables, std::size_t table, const AppSpec& app);
/// The keys of a table as a policy of app_under(`scenario`, its loss), without its lower bounds: XPUs
/// are indices into platform_with(platform_under()). xpu -1: it uses an XPU that is lost.
[[nodiscard]] Policy keys_under(const Tables& tables, std::size_t table, const AppSpec& app,
                                const Platform& platform, const Scenario& scenario);
/// The platform with XPUs for what is off in some table, and [xnode] where a table has it there: changes
/// from one table to another are about that.
[[nodiscard]] Platform platform_of_all(const Tables& tables, const Platform& platform);
[[nodiscard]] std::vector<int> xpus_on(const Platform& platform_of_all, const Table& table,
                                       const AppSpec& app);
/// Of chains that take `us` what tables are compared by: the largest relative to its deadline; where no chain has
/// one, the sum of all, or the largest of an app that releases one at a time.
struct Objective {
  double value = 0;  ///< parts of a deadline; microseconds
  int chain = -1;    ///< whose it is; -1: it is the sum
};
[[nodiscard]] Objective chain_objective(const AppSpec& app, const std::vector<std::int64_t>& us);
/// Microseconds: what `value` comes to for that chain; a sum is what it is.
[[nodiscard]] std::int64_t objective_us(const AppSpec& app, double value, int chain);
/// What the chains' own bounds come to.
[[nodiscard]] std::int64_t bound_of_chains(const Served& served, const AppSpec& app);
/// Sets what follows from the chains: Served::worst_case_us, and lower_bound_us unless more is proven.
void set_figures(Tables& tables, const AppSpec& app);

/// From table `from` to `to`. Null: they are the same, or the file has none.
[[nodiscard]] const Handover* handover_of(const Tables& tables, int from, int to);
/// [chain] whether a table of these keys has it.
[[nodiscard]] std::vector<char> chains_of(const Policy& keys);
/// Whether table `from` and table `to` both have the chain.
[[nodiscard]] bool both_have(const Tables& tables, int from, int to, std::size_t chain);
/// The table has an XNode on an XPU that the scenario has lost.
[[nodiscard]] bool needs_lost(const Table& table, const Platform& platform,
                              const Scenario& scenario);

/// [chain]: the largest worst case of all tables, and of those changes that claim one.
[[nodiscard]] std::vector<std::int64_t> largest_claims(const Tables& tables);

/// Table number `table` as a policy of the whole app, to be made at the start of a run. XNodes whose
/// module is off there are where the table of the first scenario has them: they get no job.
[[nodiscard]] PriorityPlan whole_policy(const Tables& tables, std::size_t table, const AppSpec& app,
                                        const Platform& platform);

/// What a run makes at its start: instances of XNodes, by variant and XPU, for all tables together.
[[nodiscard]] std::size_t instances(const Tables& tables);
/// What that costs by app.json (XNodeSpec::memory_kb): of `measured` of the instances.
struct InstanceMemory {
  std::int64_t kb = 0;
  std::size_t measured = 0;
};
[[nodiscard]] InstanceMemory memory_of_instances(const Tables& tables, const AppSpec& app,
                                                 const Platform& platform);
/// XNodes that both tables have, and have elsewhere or as another variant.
[[nodiscard]] std::size_t moves(const Table& a, const Table& b);

/// Of this app (name and hash); every table a policy that validate() accepts, at its envelope; losses that loss.h
/// allows, in degraded scenarios alone.
[[nodiscard]] Status validate(const Tables& tables, const AppSpec& app, const Platform& platform);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Tables: several policies for one app, and which of them serves which scenario. File: tables.json.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/loss.h"
#include "model/policy.h"
#include "model/priority_plan.h"
#include "model/scenario.h"

namespace xauto {

/// One policy without its times, which depend on the scenario.
struct Table {
  std::string name;
  std::vector<int> xpu;  ///< [xnode] index into Platform::xpus; -1: its module is off
  std::vector<std::int64_t>
      priority;  ///< [xnode] as PriorityPlacement::priority; of keys: assignment_of()
  std::vector<std::pair<int, int>> order;
  Loss loss = {};  ///< none, unless all scenarios that it serves are degraded
  bool operator==(const Table&) const = default;
};

/// Of a chain that the table does not have, since a module on its way is off (kept_chains).
inline constexpr std::int64_t kNotThere = -1;

/// How a scenario is served.
struct Served {
  int table = -1;
  std::int64_t worst_case_us = 0;   ///< of every execution within the scenario's WCETs
  std::int64_t lower_bound_us = 0;  ///< proven: under this scenario no policy is shorter
  /// [chain] of tables of keys: proven, as ChainClaim::lower_bound_us, of what the table's loss
  /// leaves; kNotThere: the table does not have the chain. The two above follow from it
  /// and from the table's chains: of the chain whose worst case is longest relative to its deadline,
  /// and what that comes to in any policy; without deadlines the sums over all chains.
  std::vector<std::int64_t> chain_bound_us = {};
  bool operator==(const Served&) const = default;
};

/// Of a release that is under way when scenario `to` takes the place of `from`: it keeps the table of
/// `from` to its end.
struct Change {
  int from = -1, to = -1;  ///< scenarios
  /// Of every execution within across(from, to); nullopt: it may need an XPU that is lost.
  std::optional<std::int64_t> worst_case_us;
  bool operator==(const Change&) const = default;
};

/// Of tables of keys: a run goes from one table to another without a pause, and each release keeps
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
  std::vector<Served> serves;   ///< [scenario]
  std::vector<Change> changes;  ///< all (from, to) of different scenarios, in that order; or none
  /// [table] keys and holds, also of what is off (app_with), and each chain's
  /// worst case in every scenario that the table serves, or kNotThere. Empty: the app releases one at a time, and tables have priorities.
  std::vector<Policy> keys = {};
  std::vector<Handover> handovers =
      {};                      ///< all (from, to) of different tables, in that order; or none
  std::int64_t notice_us = 0;  ///< they count on it that a job that takes too long is known by then
  std::int64_t solve_ms = 0;
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

/// By when a release is to end: the least of its deadlines; nullopt: there is none.
[[nodiscard]] std::optional<std::int64_t> time_for_a_release(const AppSpec& app);
/// kInvalid: tables of priorities of this app would claim what is not so. They claim one time, of a whole release, in
/// which nothing is transferred; and one deadline is held against it.
[[nodiscard]] Status may_have_priorities(const AppSpec& app);

/// What a table has to schedule under `scenario`, and on what: app_with() of app_under().
[[nodiscard]] AppSpec app_under(const AppSpec& app, const Scenario& scenario, const Loss& loss);
/// A table as a policy of that app, without its times and claims: XPUs are indices into
/// platform_under(). xpu -1: it uses an XPU that is lost.
[[nodiscard]] PriorityPlan policy_under(const Table& table, const AppSpec& app,
                                        const Platform& platform, const Scenario& scenario);

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
/// Sets each table's priorities: those that come nearest to its keys (assignment_of).
void set_priorities(Tables& tables);
/// Sets what follows from the chains' figures: the two of each Served.
void set_figures(Tables& tables, const AppSpec& app);
/// The largest worst case relative to its deadline, 0 where none has one; and
/// the sum. `us`: by chain.
struct Objective {
  double late = 0;
  std::int64_t sum_us = 0;
  int chain = -1;  ///< whose `late` is
};
[[nodiscard]] Objective chain_objective(const AppSpec& app, const std::vector<std::int64_t>& us);

/// From scenario `from` to `to`; of keys, from table to table. Null: they are the same, or the file has none.
[[nodiscard]] const Change* change_of(const Tables& tables, int from, int to);
[[nodiscard]] const Handover* handover_of(const Tables& tables, int from, int to);
/// [chain] whether a table, of these keys, has it.
[[nodiscard]] std::vector<char> chains_of(const Policy& keys);
/// Whether table `from` and table `to` both have the chain.
[[nodiscard]] bool both_have(const Tables& tables, int from, int to, std::size_t chain);
/// The table has an XNode on an XPU that the scenario has lost.
[[nodiscard]] bool needs_lost(const Table& table, const Platform& platform,
                              const Scenario& scenario);

/// Tables of keys, [chain]: the largest worst case of all tables, and of those changes that claim one.
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

/// Of this app (name and hash); every table a policy that validate() accepts, under each scenario
/// that it serves too; losses that loss.h allows, in degraded scenarios alone.
[[nodiscard]] Status validate(const Tables& tables, const AppSpec& app, const Platform& platform);

}  // namespace xauto

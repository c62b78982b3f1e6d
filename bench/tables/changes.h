// SPDX-License-Identifier: Apache-2.0
// Releases during which the scenario changes, played with arithmetic of its own: the instant of the
// change and all execution times are drawn, and climb where that makes the release longer.
#pragma once

#include <cstdint>

#include "model/tables.h"

namespace xauto::bench {

struct Attack {
  std::int64_t releases = 0;
  std::int64_t above = 0;  ///< longer than their change's worst_case_us
  double nearest = 0;      ///< the longest of them over it
  /// The same releases where jobs that have not begun at the change take the new table's XPUs and
  /// order at once; held against the larger of both scenarios' worst cases, which is all that such a
  /// protocol could claim without a proof of its own.
  std::int64_t moved_above = 0;
  double moved_worst = 0;  ///< the longest over that
};

/// `releases` in all, spread over the changes of `tables` that claim anything.
[[nodiscard]] Attack attack_changes(const AppSpec& app, const Platform& platform,
                                    const Tables& tables, std::int64_t releases,
                                    std::uint64_t seed);

/// Plays of three releases, a period apart: the first meets the change, the others have the new table.
struct Overlap {
  std::int64_t plays = 0;
  std::int64_t above = 0;         ///< plays in which a release was longer than XAuto claims
  std::int64_t first_above = 0;   ///< of them, those in which the first one was
  std::int64_t others_above = 0;  ///< likewise, another one
  double worst = 0;               ///< the longest release over what is claimed of it
  std::int64_t met = 0;  ///< plays in which the next one was due before the first had ended
  /// Of these, the ones that did not climb, and so are the same ones for each rule.
  std::int64_t drawn = 0;
  double first_of_claim = 0;  ///< sum over them: the first release over its claim
  double next_of_own = 0;     ///< likewise, the second one over its scenario's worst case

  void add(const Overlap& more);
};

/// Two rules for a change of tables, at the highest rate at which releases of neither table meet: the
/// period is the longer of both scenarios' worst cases. Claimed from the nominal release on: the first
/// release takes the change's worst case at most, the others its delay and their scenario's.
struct Rules {
  std::int64_t pairs = 0;  ///< changes of table in which releases can meet at that rate
  Overlap waits;           ///< XAuto's: a release begins when what is in flight has ended
  Overlap own;  ///< nobody waits; jobs keep their tables' priorities, and the higher one preempts
};

/// `plays` of each rule, spread over those changes. A module is in one activation at a time by both.
[[nodiscard]] Rules attack_rules(const AppSpec& app, const Platform& platform, const Tables& tables,
                                 std::int64_t plays, std::uint64_t seed);

}  // namespace xauto::bench

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

}  // namespace xauto::bench

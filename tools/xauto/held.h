// SPDX-License-Identifier: Apache-2.0
// Holds of a policy of keys: what each of them buys, as the checker derives it, and what it costs on an ordinary day,
// as the play shows it. A hold that nobody asks about looks like a fault of the scheduler.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/json_value.h"
#include "model/platform.h"
#include "model/policy.h"
#include "solver/keys/check.h"

namespace xauto::cli {

/// A chain, with the hold and without it; in us.
struct Differs {
  std::size_t chain = 0;  ///< index into AppSpec::chains
  std::int64_t with_us = 0, without_us = 0;
};
/// Of an XNode, all its holds at once.
struct Held {
  int xnode = 0;
  std::int64_t longest_us = 0;  ///< after the nominal release
  bool derived = false;  ///< the check knows what follows without them: `refused`, or `longer`
  std::vector<std::string> refused;  ///< XPUs on which no keys stand without them
  std::vector<Differs> longer;       ///< claims that are longer without them, the most first
  std::vector<Differs>
      sooner;  ///< medians that are shorter without them, by 1 % or more, the most first
};
struct Holds {
  std::vector<Held> list;  ///< the longest first
  int untried = 0;         ///< so many more had no turn
};

/// Of `policy`, of which `report` is. Each XNode is tried by itself; at most `limit_s` seconds, and then the one that is
/// being tried. Medians are of kPlayedS seconds at usual times (solver/keys/uncertified.h).
inline constexpr std::int64_t kPlayedS = 10;
[[nodiscard]] Holds holds_of(const AppSpec& app, const Platform& platform, const Policy& policy,
                             const solver::keys::CheckReport& report, double limit_s);

/// Who is held, in a line that names the verb that says why; empty: nobody is.
[[nodiscard]] std::string held_line(const AppSpec& app, const Policy& policy);
/// Lines for people; empty: nothing is held.
[[nodiscard]] std::string holds_text(const AppSpec& app, const Policy& policy, const Holds& holds);
/// `holds` of xauto.explanation.
[[nodiscard]] Json holds_json(const AppSpec& app, const Holds& holds);

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// What a change of the app, of the platform or of one placement would bring. Each answer is a search
// of its own, with its certificate; that a change brings nothing is never proven.
#pragma once

#include <string>
#include <vector>

#include "solver/keys/solve.h"

namespace xauto::solver::keys {

struct WhatIf {
  std::string change;  ///< "camera at 60 Hz", "gpu at 80 % of its WCETs", "one more dla"
  Outcome outcome = Outcome::kUnknown;
  std::string overload;                     ///< kUnsustainable: why
  std::vector<std::int64_t> worst_case_us;  ///< [chain], kPolicy
};

/// The app with another period of this source; its component has one, so all of its sources change.
[[nodiscard]] Result<AppSpec> with_period(const AppSpec& app, int source, Period period);

/// `text`: SOURCE=HZ (as `rate_hz`), TYPE=PERCENT% (all WCETs there), or +TYPE (one more like the
/// first of them). The search begins with `policy`. kInvalid: none of these.
[[nodiscard]] Result<WhatIf> assume(const AppSpec& app, const Platform& platform,
                                    const Policy& policy, const std::string& text,
                                    const Options& options);

struct Moves {
  std::vector<WhatIf> tried;
  std::size_t untried = 0;  ///< the time was over before
  double each_s = 0;        ///< limit of each search
};

/// One XNode of `xnodes` elsewhere, everybody else where `policy` has them: for each other XPU that
/// it may run on, of equal ones that serve nobody only one. What is pinned, forbidden, or not with its group is no
/// move. `options.time_limit_s` is of all together; `options.threads` are searched at a time.
[[nodiscard]] Result<Moves> moves(const AppSpec& app, const Platform& platform,
                                  const Policy& policy, const std::vector<int>& xnodes,
                                  const Options& options);

}  // namespace xauto::solver::keys

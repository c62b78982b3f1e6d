// SPDX-License-Identifier: Apache-2.0
// Where nothing can be certified a robot runs all the same: the policy that is least late at usual times, and how far
// its app is from one that can be certified.
//
// Candidates are certified for the same app with shorter jobs: at its usual times, and with all WCETs times a
// common factor. One is made without a search, so there always is one. They are played at usual times, as they
// are, and without what only a certificate needs: holds and order.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "solver/keys/play.h"
#include "solver/keys/solve.h"

namespace xauto::solver::keys {

/// Of a WCET for which no typical time is known, so many percent are usual.
inline constexpr std::int64_t kUsualPct = 80;

struct XpuLoad {
  double at_wcets = 0, usual = 0;  ///< parts of its time
};

struct Uncertified {
  Policy policy;                     ///< not certified
  std::optional<PlayReport> played;  ///< for `seconds`, at usual times; none: it cannot be played
  std::int64_t seconds = 0;
  std::vector<XpuLoad> load;  ///< [xpu] by the policy
  /// The largest percentage of all WCETs at which a policy was certified; none: at no percentage, in this time.
  std::optional<std::int64_t> certified_pct;
  /// The largest at which one was certified that misses no deadline.
  std::optional<std::int64_t> in_time_pct;
  /// The least percentage at which it is proven that no policy keeps up; none: it is not proven.
  std::optional<std::int64_t> overloaded_pct;
};

/// For an app of which solve() has certified nothing. `options`: as for solve(); the time limit is for all of it.
[[nodiscard]] Result<Uncertified> least_late(const AppSpec& app, const Platform& platform,
                                             const Options& options);

/// Whether a policy is certified. The first is enough; `in_time`: that misses no deadline.
struct Certifies {
  Outcome outcome = Outcome::kUnknown;
  bool late = false;  ///< kPolicy: it misses a deadline
  Policy policy;      ///< kPolicy
};
[[nodiscard]] Result<Certifies> certifies(const AppSpec& app, const Platform& platform,
                                          const Options& options, bool in_time);

/// All WCETs as they usually are.
[[nodiscard]] AppSpec at_usual_times(AppSpec app);
/// All WCETs, rounded up.
[[nodiscard]] AppSpec at_percent(AppSpec app, std::int64_t percent);

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
// Scenario: under which execution times and with which XPUs an app may have to run: a clock point, a
// power mode, what else runs, an XPU that is lost. File: scenarios.json. Value types; `validate` says
// whether they make sense, and every reader calls it.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/profile.h"

namespace xauto {

/// What a file of the machine has to say: a clock in /sys/class/devfreq, a power mode's name. Exactly
/// `equals`, or at least one of the other two.
struct Condition {
  std::string file;  ///< absolute path; its text without space around it
  std::optional<std::int64_t> at_least, at_most;  ///< of a file that holds one whole number
  std::optional<std::string> equals;
  bool operator==(const Condition&) const = default;
};

struct Scenario {
  std::string name;  ///< unique, "gpu at 60 %"
  /// XPU type -> percent of the app's WCETs there, rounded up to the next microsecond; 100 where
  /// nothing is said.
  std::map<std::string, std::int64_t, std::less<>> wcet_scale_pct = {};
  /// XNode -> XPU type -> WCET, instead of what scaling gives.
  std::map<std::string, std::map<std::string, std::int64_t, std::less<>>, std::less<>> wcet_us = {};
  std::vector<std::string> lost = {};  ///< XPUs that are not there, by id
  /// Under which it was measured: a run is in this scenario while all of them hold. Empty: the machine
  /// does not tell.
  std::vector<Condition> when = {};
  /// What the app may lose (loss.h) it may lose here, where nothing else keeps its deadline.
  bool degraded = false;
  /// XNode -> its variant -> XPU type -> WCET, as wcet_us.
  std::map<std::string,
           std::map<std::string, std::map<std::string, std::int64_t, std::less<>>, std::less<>>,
           std::less<>>
      variant_wcet_us = {};
  bool operator==(const Scenario&) const = default;
};

struct Scenarios {
  std::string app;  ///< AppSpec::name
  std::vector<Scenario> list;
  bool operator==(const Scenarios&) const = default;
};

inline constexpr std::size_t kMaxScenarios = 200;
inline constexpr std::size_t kMaxConditions = 64, kMaxConditionText = 200;  ///< of one; of `equals`
inline constexpr std::int64_t kMaxScalePct = 100'000;

/// Names unique and not empty, types and XPUs of the platform, XNodes and implementations of the
/// app, percentages from 1 to kMaxScalePct, WCETs at least 1 us; in each scenario every XNode can
/// run somewhere (kInfeasible). The first, with which a run begins, is not degraded. `at`: the JSON pointer of the list, for messages.
[[nodiscard]] Status validate(const Scenarios& scenarios, const AppSpec& app,
                              const Platform& platform, const std::string& at = "/scenarios");

/// What is to be scheduled under a scenario, and on what: other WCETs, the lost XPUs left out. Of
/// what `validate` has passed. Where loads are stated, a scenario scales the longest (at_longest).
[[nodiscard]] AppSpec app_under(const AppSpec& app, const Scenario& scenario);
[[nodiscard]] Platform platform_under(const Platform& platform, const Scenario& scenario);

/// What holds under `a` holds under `b`: no WCET of `b` is longer, and `b` has lost no XPU that `a`
/// has. `under_a`, `under_b`: app_under() of each.
[[nodiscard]] bool covers(const Scenario& a, const AppSpec& under_a, const Scenario& b,
                          const AppSpec& under_b);

/// What was measured, under a name.
struct NamedProfile {
  std::string name;
  Profile profile;
};
/// A scenario for each, with the WCETs of all its XNodes. kInvalid: they are not of one app; one was
/// not measured to its end, or not on all types of XPU that another was: what it lacks would count as
/// the app has it.
[[nodiscard]] Result<Scenarios> scenarios_of(const std::vector<NamedProfile>& profiles,
                                             const Platform& platform, WcetFrom from);

/// Gives each of scenarios_of(profiles) as conditions (Scenario::when) the clocks at which its profile
/// was measured: at least those, less Reading::jitter(). Where clocks do not tell two
/// profiles apart, the power mode is a condition, too. Either all scenarios have conditions then or
/// none: a run in which some lack them would take what it does not know for a slower machine. Returns why none has; empty: they
/// have, or there is one profile only.
[[nodiscard]] std::string set_conditions(Scenarios& scenarios,
                                         const std::vector<NamedProfile>& profiles);

/// What a release has to live with during which one scenario takes the place of another: of each
/// WCET the larger, and all XPUs that either has lost.
[[nodiscard]] Scenario across(const AppSpec& app, const Scenario& from, const Scenario& to);

}  // namespace xauto

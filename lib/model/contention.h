// SPDX-License-Identifier: Apache-2.0
// What an XNode takes beside loads of other XPUs (XNodeSpec::beside). What a policy counts: docs/keys.md, "Contention".
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto {

/// XPU type -> XPUs of it on which jobs run.
using Load = std::map<std::string, std::int64_t, std::less<>>;

/// Types of load that the XNode states for XPUs of type `on`.
[[nodiscard]] std::set<std::string, std::less<>> stated_loads(const XNodeSpec& xnode,
                                                              std::string_view on);
/// Its WCET on `on` beside `load`, of which the types that it does not state are left out: the least that is stated beside
/// at least that. nullopt: it has no implementation there, or nothing is stated beside so much.
[[nodiscard]] std::optional<std::int64_t> wcet_beside(const XNodeSpec& xnode, std::string_view on,
                                                      const Load& load);
/// The longest that is stated; 0: it has no implementation there.
[[nodiscard]] std::int64_t longest_wcet(const XNodeSpec& xnode, std::string_view on);

/// As if every other XPU were loaded all the time: the longest for each WCET, and nothing stated beside. What tables and
/// several apps together count.
[[nodiscard]] AppSpec at_longest(AppSpec app);

/// Types with an implementation; each load once, not empty; times no shorter than alone.
[[nodiscard]] Status validate_beside(const XNodeSpec& xnode, const std::string& where);
/// Each XNode has a WCET beside the most that the app can load on this platform of the types that it states. So it has one
/// beside whatever it meets. kInvalid, with what is missing.
[[nodiscard]] Status validate_beside_on(const AppSpec& app, const Platform& platform);

/// What the policy counts for XNode `i` on its XPU: Placement::wcet_us, or the WCET.
[[nodiscard]] std::int64_t counted_wcet_us(const AppSpec& app, const Platform& platform,
                                           const Policy& policy, std::size_t i);
/// Types of XPUs that the policy uses beside an XNode that does not state such a load, in order.
[[nodiscard]] std::set<std::string, std::less<>> loads_not_stated(const AppSpec& app,
                                                                  const Platform& platform,
                                                                  const Policy& policy);
/// The line on these: what a claim takes for granted. Empty: there are none.
[[nodiscard]] std::string independence_of(const AppSpec& app, const Platform& platform,
                                          const Policy& policy);

/// "1 dla, 2 gpu"
[[nodiscard]] std::string words_of(const Load& load);

}  // namespace xauto

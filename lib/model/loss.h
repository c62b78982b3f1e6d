// SPDX-License-Identifier: Apache-2.0
// What an app can do without, where nothing else keeps its deadline: XNodes in a variant of less
// quality, optional modules that are off. Value types; a table (tables.h) may have a loss, and then
// serves scenarios that are marked as degraded alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"

namespace xauto {

struct Loss {
  /// [xnode] index into XNodeSpec::variants; -1: its own implementations. Empty: of all of them.
  std::vector<int> variant = {};
  std::vector<std::string> off = {};  ///< modules that get no release, in alphabetical order
  bool operator==(const Loss&) const = default;

  [[nodiscard]] bool none() const;
  [[nodiscard]] int variant_of(std::size_t xnode) const {
    return variant.empty() ? -1 : variant[xnode];
  }
  [[nodiscard]] bool is_off(const std::string& module) const;
};

/// Variants with names, each once, with implementations, WCETs in range, and a quality of 1 to 100.
/// No edge from an optional module to one that is not, since that would wait for ever. Of an app that
/// releases one at a time, not all are optional.
[[nodiscard]] Status validate_losses(const AppSpec& app);

/// Variants that there are; modules that are optional, each once, with all that hears of them by
/// edges; some chain has no module that is off. `at`: the JSON pointer of the table, for messages.
[[nodiscard]] Status validate(const Loss& loss, const AppSpec& app, const std::string& at);

/// Of XNode or of its variant (-1: its own), on a type of XPU.
[[nodiscard]] std::optional<std::int64_t> wcet_of(const XNodeSpec& xnode, int variant,
                                                  std::string_view type);

/// How much is lost: for each XNode 100 less its variant's quality in percent, for each module that
/// is off 100. 0: nothing.
[[nodiscard]] std::int64_t loss_pct(const Loss& loss, const AppSpec& app);

/// What the app has to do without on this platform: optional modules of which an XNode can run nowhere,
/// with all that wait for them; and for an XNode that only variants let run, the best of these. What is
/// then left may not run all the same: validate_on() says so.
[[nodiscard]] Loss forced_loss(const AppSpec& app, const Platform& platform);

/// "lane off, fcd.infer small"; "" for none.
[[nodiscard]] std::string words_of(const Loss& loss, const AppSpec& app);

/// [xnode] that nobody hears by an edge, or nobody once some optional modules are off.
[[nodiscard]] std::vector<char> ends_of(const AppSpec& app);
/// XNodes whose module is not off: [XNode of release_of()].
[[nodiscard]] std::vector<int> kept(const AppSpec& app, const Loss& loss);
/// [chain of app_with()]: those on none of whose ways, by edges and samples, a module is off. A result that passes
/// one that is off is old, or there is none.
[[nodiscard]] std::vector<int> kept_chains(const AppSpec& app, const Loss& loss);
/// What is left to schedule. Variants have taken the place of the XNodes' own implementations. Modules that are off
/// are in it, so that components, and by them the releases of all others, stay what they are: an XNode that is off
/// takes 1 us on an XPU that only its module has (platform_with). What is not off waits for none of these, so no other
/// job is later by that.
[[nodiscard]] AppSpec app_with(const AppSpec& app, const Loss& loss);
/// The same with all chains, so that two tables with different losses have the same shape.
[[nodiscard]] AppSpec app_of_all_chains(const AppSpec& app, const Loss& loss);
/// One release of what is left, as a plan knows it: without what is off, chains and transfers.
[[nodiscard]] AppSpec release_of(const AppSpec& app, const Loss& loss);
/// That XPU's id, and its type.
[[nodiscard]] std::string off_xpu(const std::string& module);
/// With such an XPU for each of these modules; preempting it costs nothing.
[[nodiscard]] Platform platform_with(Platform platform, const std::vector<std::string>& off);

}  // namespace xauto

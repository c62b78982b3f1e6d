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
/// Version 1, of which tables are: no edge from an optional module to one that is not, since that would
/// wait for ever, and not all are optional.
[[nodiscard]] Status validate_losses(const AppSpec& app);

/// Variants that there are; modules that are optional, each once, with all that hears of them by
/// edges. `at`: the JSON pointer of the table, for messages.
[[nodiscard]] Status validate(const Loss& loss, const AppSpec& app, const std::string& at);

/// Of XNode or of its variant (-1: its own), on a type of XPU.
[[nodiscard]] std::optional<std::int64_t> wcet_of(const XNodeSpec& xnode, int variant,
                                                  std::string_view type);

/// How much is lost: for each XNode 100 less its variant's quality in percent, for each module that
/// is off 100. 0: nothing.
[[nodiscard]] std::int64_t loss_pct(const Loss& loss, const AppSpec& app);

/// "lane off, fcd.infer small"; "" for none.
[[nodiscard]] std::string words_of(const Loss& loss, const AppSpec& app);

/// [XNode of app_with()] index in `app`.
[[nodiscard]] std::vector<int> kept(const AppSpec& app, const Loss& loss);
/// What is left to schedule, an app of version 1: modules that are off are not in it, variants have
/// taken the place of the XNodes' own implementations.
[[nodiscard]] AppSpec app_with(const AppSpec& app, const Loss& loss);

}  // namespace xauto

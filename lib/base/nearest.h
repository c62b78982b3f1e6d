// SPDX-License-Identifier: Apache-2.0
// Which word was meant.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace xauto {

/// Of `words` the one that is nearest by edits, of which two neighbours exchanged are one: a third of its letters may be
/// wrong, or all behind what is given may be missing. Empty: none is so near.
[[nodiscard]] std::string nearest(std::string_view given, const std::vector<std::string>& words);

}  // namespace xauto

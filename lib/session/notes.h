// SPDX-License-Identifier: Apache-2.0
// Notes of a report, which are one text.
#pragma once

#include <string>

namespace xauto::runtime {

/// "" adds none.
inline void add_note(std::string& notes, const std::string& text) {
  if (!text.empty()) notes += (notes.empty() ? "" : "; ") + text;
}

}  // namespace xauto::runtime

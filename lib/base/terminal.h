// SPDX-License-Identifier: Apache-2.0
// What may be drawn on a terminal, by what its user says in the environment.
#pragma once

#include <cstdlib>
#include <string_view>

#include <unistd.h>

namespace xauto {

/// Whether lines on it may be drawn over: it is a terminal that understands escapes (TERM is there, and not "dumb").
/// Threads: any, while nobody sets the environment.
[[nodiscard]] inline bool can_draw(int fd) {
  const char* const term = std::getenv("TERM");
  return isatty(fd) == 1 && term != nullptr && std::string_view(term) != "dumb" &&
         !std::string_view(term).empty();
}

/// ... and coloured. https://no-color.org: NO_COLOR, if it is not empty, is a wish for none.
[[nodiscard]] inline bool can_colour(int fd) {
  const char* const none = std::getenv("NO_COLOR");
  return can_draw(fd) && (none == nullptr || *none == '\0');
}

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// How an unprivileged xauto comes by the priorities that an administrator has granted: once, at its
// start, it becomes xauto-grant, which raises the limit and becomes xauto again (docs/runtime.md,
// "Privilege"). Coordinators, the emulator and the app inherit the limit.
#pragma once

#include <string>

namespace xauto::cli {

struct Granted {
  int lowest = 0, highest = 0;  ///< 0: nothing was granted, or nothing had to be
  std::string why;              ///< nothing was granted though it was asked for; for people
};

/// Does not return if there is something to ask for. Before anything was begun: the same verb
/// starts anew with the same arguments.
void obtain_priorities(char** argv);
/// What became of it.
[[nodiscard]] const Granted& granted();

}  // namespace xauto::cli

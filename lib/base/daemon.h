// SPDX-License-Identifier: Apache-2.0
// What the two daemons have in common: how they are stopped, how they tell that they are ready, how
// they run. They are children of the xauto tool, never started by hand.
#pragma once

#include <string>

#include "base/unique_fd.h"

namespace xauto::daemon {

/// Blocks SIGTERM and SIGINT and returns a descriptor that is readable once one of them has come.
[[nodiscard]] UniqueFd stop_signals();

/// Resident memory, exact timers and SCHED_FIFO at up to `priority`, each as far as it is
/// permitted.
void settle(const std::string& name, int priority);

/// Tells the parent that the socket is there; `fd` < 0: nobody waits for that.
void tell_ready(int fd);

}  // namespace xauto::daemon

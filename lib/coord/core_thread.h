// SPDX-License-Identifier: Apache-2.0
// A core that another process's thread has, and has not: by its scheduling policy, which that process cannot raise
// itself. Needs CAP_SYS_NICE where the process is another user's. Any thread.
#pragma once

#include <string>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto::coord {

/// The thread that `process` calls `named` in its own PID namespace, as it is called here; 0: it has none.
[[nodiscard]] pid_t thread_of(pid_t process, pid_t named);

/// A descriptor of the process `pid` that has connected, and whether that lives: its number may be another's one day.
[[nodiscard]] UniqueFd process_behind(int socket, pid_t pid);
[[nodiscard]] bool lives(int process);

/// Of core3: 3; -1: that is no core.
[[nodiscard]] int core_number(const std::string& hardware);

/// What it creates is ordinary.
[[nodiscard]] bool give_core(pid_t thread, int core);
/// It is an ordinary thread, of any core again where `anywhere`.
void take_core(pid_t thread, bool anywhere);
/// It may say START at once.
void let_ask(pid_t thread);
/// All threads of a process are ordinary: whoever has raised them has gone.
void take_cores(pid_t process);
/// The kernel ends a thread of this process that has a core for as long as kRtLimitNs: whoever would take it may have
/// been killed. kPermission: without CAP_SYS_RESOURCE.
[[nodiscard]] Status limit_raised(pid_t process);
/// Whether this process may give and take cores of others' threads.
[[nodiscard]] bool may_give_cores();

}  // namespace xauto::coord

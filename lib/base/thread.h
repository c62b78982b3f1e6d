// SPDX-License-Identifier: Apache-2.0
// A thread, or why there is none. std::thread throws where limits of memory or threads are reached.
#pragma once

#include <system_error>
#include <thread>
#include <utility>

#include <xauto/result.h>

namespace xauto {

/// kUnavailable: the system refuses one more.
template <class F>
Result<std::thread> start_thread(F&& run) {
  try {
    return std::thread(std::forward<F>(run));
  } catch (const std::system_error& e) {
    return fail(
        ErrorCode::kUnavailable, std::string("no more threads: ") + e.what(), "",
        "raise the limits of threads and memory (`ulimit -u`, `ulimit -v`, systemd's TasksMax=)");
  }
}

}  // namespace xauto

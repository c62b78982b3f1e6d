// SPDX-License-Identifier: Apache-2.0
// The profiler: the whole app on recorded or generated input, one XNode at a time, each XNode in
// turn on each XPU instance that it has an implementation for.
#pragma once

#include <atomic>
#include <string>

#include <xauto/result.h>

#include "graph/app_spec.h"
#include "graph/graph.h"
#include "model/platform.h"
#include "session/session.h"

namespace xauto::runtime {

struct Profiled {
  std::string text;          ///< profile.json's, maybe an incomplete one's
  bool left_behind = false;  ///< a thread that may be in an exec for ever: only _exit ends it
};

/// Uses session.platform, presence, input, warmup, repetitions, margin_pct, exec_limit_s and
/// stable_rounds. `app` must outlive the process if a thread is left behind.
[[nodiscard]] Result<Profiled> profile(const detail::AppSpecErased& app, const Session& session,
                                       const std::atomic<bool>& stop);

/// What Session says of Mode::kLoad, until `stop` or the end of the process that asked for it.
[[nodiscard]] Status load(const detail::AppSpecErased& app, const Session& session,
                          const std::atomic<bool>& stop);

/// The graph as profile.json without samples: what `describe` answers.
[[nodiscard]] Result<std::string> describe(const Graph& graph, const Platform& platform);

}  // namespace xauto::runtime

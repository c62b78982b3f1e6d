// SPDX-License-Identifier: Apache-2.0
// The profiler: the whole app on recorded or generated input, one XNode at a time, each XNode in
// turn on each XPU instance that it has an implementation for.
#pragma once

#include <string>

#include <xauto/result.h>

#include "model/platform.h"
#include "runtime/app_spec.h"
#include "runtime/graph.h"
#include "runtime/session.h"

namespace xauto::runtime {

/// profile.json's text. Uses session.platform, input, warmup, repetitions, margin_pct.
[[nodiscard]] Result<std::string> profile(const detail::AppSpecErased& app, const Session& session);

/// The graph as profile.json without samples: what `describe` answers.
[[nodiscard]] Result<std::string> describe(const Graph& graph, const Platform& platform);

}  // namespace xauto::runtime

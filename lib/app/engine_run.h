// SPDX-License-Identifier: Apache-2.0
// One run of an app's engine, however the app was started.
#pragma once

#include <atomic>
#include <memory>

#include <xauto/result.h>

#include "graph/app_spec.h"
#include "session/run_report.h"
#include "session/session.h"

namespace xauto::app {

struct Ran {
  Result<runtime::RunReport> report = fail(ErrorCode::kInternal, "not run");
  bool member = false;  ///< the hub has been told
  /// An exec never returned: its thread goes on using the engine, and all that `held` holds.
  bool stuck = false;
};

/// `held`: app, session and stop; kept for ever if the run gets stuck.
[[nodiscard]] Ran run_engine(const detail::AppSpecErased& app, const runtime::Session& session,
                             std::atomic<bool>& stop, std::shared_ptr<const void> held);

}  // namespace xauto::app

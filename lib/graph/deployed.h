// SPDX-License-Identifier: Apache-2.0
// The app as a deployment wants it: a module of the program under several names, topics under other
// names. Every process of a run, and the profiler, makes the same of it; all that follows, from
// Graph to policy.json, knows the new names only. An exec goes on asking by the program's.
#pragma once

#include <xauto/result.h>

#include "graph/app_spec.h"
#include "model/deployment.h"

namespace xauto::detail {

/// Whether anything has another name than in the program.
[[nodiscard]] bool renames(const Deployment& deployment);

/// Errors (kInvalid): modules and topics that the program does not have. Whose deployment it is, who
/// reads it has asked. What the names then amount to, Graph::build judges.
/// A copy, also where nothing is renamed: a callback that changes itself starts anew in it.
[[nodiscard]] Result<AppSpecErased> deployed(const AppSpecErased& app,
                                             const Deployment& deployment);

}  // namespace xauto::detail

// SPDX-License-Identifier: Apache-2.0
// The program around an app that an `xauto` tool has started: signals, the session that was handed
// down, the answer. App::main.
#pragma once

#include "graph/app_spec.h"

namespace xauto::app {

/// The exit status. Started by hand it does not return: it becomes `xauto run`.
[[nodiscard]] int program(const detail::AppSpecErased& app, char** argv);

}  // namespace xauto::app

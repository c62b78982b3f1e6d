// SPDX-License-Identifier: Apache-2.0
// --emulate and --real, of every verb that starts an app.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "cli/cli.h"
#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"
#include "xpu/presence.h"

namespace xauto::cli {

class EmulationOptions {
 public:
  void declare(Verb verb);
  /// Decides, and says on stderr what is emulated and why. `app` null: it is about to be profiled.
  [[nodiscard]] Result<std::vector<Presence>> decide(const Platform& platform,
                                                     const AppSpec* app) const;
  bool all_asked = false;  ///< as a bare --emulate would

 private:
  std::string names_;  ///< with commas between
  bool real_ = false;
  std::optional<Argument> emulate_;
};

/// " (emulated)", " (real: cpu0; emulated: gpu0)" or nothing.
[[nodiscard]] std::string in_parentheses(const Platform& platform,
                                         const std::vector<Presence>& presence);

}  // namespace xauto::cli

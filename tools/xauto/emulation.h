// SPDX-License-Identifier: Apache-2.0
// --emulate and --real, of every verb that starts an app.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "cli/cli.h"
#include "model/app.h"
#include "model/emulation_script.h"
#include "model/platform.h"
#include "model/priority_plan.h"
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

/// Of an emulation.json, on which XPUs of `platform` it may tell something: those that are emulated, or
/// may turn out to be. The emulator knows only these: what it says of another would be passed over.
[[nodiscard]] Result<EmulationScript> load_script(const std::string& path, const Platform& platform,
                                                  const std::vector<Presence>& presence);

/// " (emulated)", " (real: cpu0; emulated: gpu0)" or nothing.
[[nodiscard]] std::string in_parentheses(const Platform& platform,
                                         const std::vector<Presence>& presence);

}  // namespace xauto::cli

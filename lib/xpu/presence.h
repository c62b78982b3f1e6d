// SPDX-License-Identifier: Apache-2.0
// Which XPUs of a run are real and which are emulated. What this machine lacks is emulated. What it
// has is emulated with it, because apps without hardware compute on stand-ins everywhere, unless
// the app computes there itself (`real_on` in app.json). Flags and the platform file go before.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"
#include "model/tables.h"
#include "xpu/kind.h"

namespace xauto::xpu {

/// What a machine has.
struct Hardware {
  std::size_t cores = 0;                       ///< that this process may use
  std::map<std::string, std::size_t> devices;  ///< types with a device node: how many such XPUs
  [[nodiscard]] static Hardware here(const std::vector<Kind>& table = kinds());
  /// Types without device nodes are the app's own business: they are always there.
  [[nodiscard]] bool has(const Platform& platform, std::size_t xpu,
                         const std::vector<Kind>& table = kinds()) const;
  /// Why it has not: "this machine has 2 CPUs", "this machine has no GPU (no device node)".
  [[nodiscard]] std::string lacks(const Xpu& xpu) const;
};

/// --emulate and --real.
struct EmulationFlags {
  bool all = false;                     ///< --emulate
  bool none = false;                    ///< --real
  std::vector<std::string> names = {};  ///< --emulate gpu,cpu3: types or instances
  [[nodiscard]] bool any() const { return all || none || !names.empty(); }
};

/// [XPU]. `app` null: it is about to be profiled. Errors: a name that is no XPU; --real on a
/// machine that lacks something.
[[nodiscard]] Result<std::vector<Presence>> presence_of(const Platform& platform,
                                                        const EmulationFlags& flags,
                                                        const AppSpec* app,
                                                        const Hardware& machine);

/// Refuses a policy that places an XNode where this machine has nothing for it, naming `path`.
[[nodiscard]] Status check_placements(const AppSpec& app, const Platform& platform,
                                      const std::vector<Presence>& presence,
                                      const PriorityPlan& policy, const std::string& path);
/// Of each table.
[[nodiscard]] Status check_placements(const AppSpec& app, const Platform& platform,
                                      const std::vector<Presence>& presence, const Tables& tables,
                                      const std::string& path);

/// For people: "" if nothing is emulated, "emulated" if everything is, else which are real:
/// "real: cpu0, cpu1; emulated: gpu0, dla0".
[[nodiscard]] std::string describe(const Platform& platform, const std::vector<Presence>& presence);
/// Ids of the XPUs that are `which`, with commas between.
[[nodiscard]] std::string ids_of(const Platform& platform, const std::vector<Presence>& presence,
                                 Presence which);

/// The platform of this machine: its cores, and one of each kind with a driver, emulated if it has
/// none.
[[nodiscard]] Platform platform_of(const Hardware& machine, const std::string& name,
                                   const std::vector<Kind>& table = kinds());

}  // namespace xauto::xpu

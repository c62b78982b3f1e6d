// SPDX-License-Identifier: Apache-2.0
// What the checker reads off app, platform and policy: components, domains and the window of every
// job. Used by check*.cc alone.
//
// Time is in ticks of 1/scale us, in which all periods are whole. Windows are relative to the
// nominal release of the job's component, and are real time; nominal releases are on the grid of
// the component's clock, which may run `ppm` fast or slow.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "base/index.h"
#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::solver::keys::checking {

using Ticks = std::int64_t;
/// No time that is read, no hyperperiod is longer: sums of a hundred of them fit.
inline constexpr Ticks kMaxTicks = Ticks{1} << 55;
inline constexpr std::int64_t kMillion = 1'000'000;

struct Window {
  Ticks a = 0;  ///< ready by, if all others keep their windows
  Ticks d = 0;  ///< the key
  Ticks e = 0;  ///< not started before, whatever happens
};

struct Component {
  std::vector<int> xnodes;
  std::vector<int> sources;
  int clock = -1;
  std::int64_t ppm = 0;
  Ticks period = 0;
  Ticks phi = 0;             ///< nominal release of activation 0
  std::int64_t classes = 1;  ///< windows repeat after so many activations
  int urgent_source = -1;    ///< whose releases may be urgent; -1: none
  Ticks urgent_by = 0;
  std::int64_t urgent_apart = 0;  ///< activations from one urgent release to the next, at least
  [[nodiscard]] Ticks pattern() const { return classes * period; }
};

struct World {
  const AppSpec& app;
  const Platform& platform;
  const Policy& policy;
  std::int64_t scale = 1;
  std::vector<Component> components;
  std::vector<int> component_of;  ///< [xnode]
  std::vector<int> part_of;       ///< [xnode] components that order joins are one part
  std::vector<std::vector<std::pair<int, Ticks>>> before;  ///< [xnode] what it waits for, transfers
  std::vector<std::vector<int>> after;                     ///< [xnode] what waits for it
  std::vector<std::vector<int>> hearers;        ///< [xnode] of `after`, those that an edge leads to
  std::vector<std::vector<int>> module_xnodes;  ///< [module]
  std::vector<std::int64_t> in_flight;          ///< [module] at most
  std::vector<int> module_of;                   ///< [xnode]
  std::vector<char> entry;                      ///< [xnode] has no predecessor inside its module
  std::vector<int> order;                       ///< topological, by all that waits
  /// [xnode] on its XPU, as the policy counts it, by its host's clock; no preemption charged
  std::vector<Ticks> wcet;
  std::vector<int> host;  ///< [xnode] index into Platform::hosts; all 0 where there are none
  std::map<std::pair<int, int>, Ticks> crossing;  ///< (xnode, host) a message's time between hosts
  std::vector<std::vector<Window>> windows;       ///< [xnode][activation mod classes]
  /// The same in an urgent release; empty where an XNode does not hear of an urgent source.
  std::vector<std::vector<Window>> urgent;
  std::vector<char> hears_urgent;  ///< [xnode] of its component's urgent source, by edges

  [[nodiscard]] const Component& home(int xnode) const {
    return components[at(component_of[at(xnode)])];
  }
  [[nodiscard]] const Window& window(int xnode, std::int64_t activation) const {
    const auto& all = windows[at(xnode)];
    const auto size = static_cast<std::int64_t>(all.size());
    const std::int64_t j = activation % size;
    return all[static_cast<std::size_t>(j < 0 ? j + size : j)];
  }
  /// No activation of this class starts earlier after its nominal release, urgent or not.
  [[nodiscard]] Ticks earliest(int xnode, std::int64_t activation) const {
    const Ticks e = window(xnode, activation).e;
    const auto& all = urgent[at(xnode)];
    if (all.empty()) return e;
    const auto size = static_cast<std::int64_t>(all.size());
    return std::min(e, all[static_cast<std::size_t>((activation % size + size) % size)].e);
  }
  /// Until what `u` publishes is where `v` is.
  [[nodiscard]] Ticks passes(int u, int v) const {
    const auto found = crossing.find({u, host[at(v)]});
    return host[at(u)] == host[at(v)] || found == crossing.end() ? 0 : found->second;
  }
  [[nodiscard]] const std::string& name(int xnode) const { return app.xnodes[at(xnode)].name; }
  [[nodiscard]] double us(Ticks t) const {
    return static_cast<double>(t) / static_cast<double>(scale);
  }
  [[nodiscard]] std::int64_t us_up(Ticks t) const;
  /// [other] the least lag such that `xnode` of activation n has ended before that other XNode of
  /// activation n + lag starts; kNever: no such lag.
  [[nodiscard]] std::vector<std::int64_t> lags_after(int xnode) const { return lags(xnode, true); }
  /// [other] the least lag such that that other XNode of activation n has ended before `xnode` of
  /// activation n + lag starts.
  [[nodiscard]] std::vector<std::int64_t> lags_before(int xnode) const {
    return lags(xnode, false);
  }

 private:
  [[nodiscard]] std::vector<std::int64_t> lags(int xnode, bool forward) const;
};
inline constexpr std::int64_t kNever = std::int64_t{1} << 60;

/// Least and most real time that `x` on the grid of a clock takes; x may be below 0.
[[nodiscard]] Ticks least(Ticks x, std::int64_t ppm);
[[nodiscard]] Ticks most(Ticks x, std::int64_t ppm);
[[nodiscard]] Ticks floor_div(__int128 a, Ticks b);
[[nodiscard]] Ticks ceil_div(__int128 a, Ticks b);
/// Least common multiple; 0 where it exceeds kMaxTicks.
[[nodiscard]] Ticks lcm(Ticks a, Ticks b);

/// Hosts (check_hosts.cc): which messages cross, and that the policy's crossings are as long as their links need;
/// each module on one host, the one that the app says. WCETs and clocks as hosts read them.
[[nodiscard]] Status set_hosts(World& w);

/// Preemptions cost what hosts' clocks read meanwhile.
[[nodiscard]] Platform by_its_clocks(const Platform& platform);

/// All but the windows, which only a policy has that holds. `fine`: in ticks in which drift, too, is
/// exact, where they fit.
/// `multiple_of`: the ticks of a microsecond are a multiple of that. `others`: other apps may be on the XPUs.
[[nodiscard]] Result<World> structure(const AppSpec& app, const Platform& platform,
                                      const Policy& policy, bool fine, Ticks multiple_of = 1);
[[nodiscard]] Result<World> derive(const AppSpec& app, const Platform& platform,
                                   const Policy& policy, bool fine = true, Ticks multiple_of = 1,
                                   bool others = false);

}  // namespace xauto::solver::keys::checking

// SPDX-License-Identifier: Apache-2.0
#include "model/contention.h"

#include <algorithm>
#include <utility>

#include "base/index.h"
#include "model/refusal.h"

namespace xauto {
namespace {

/// `more` has at least the XPUs of `load` of each type, of those in `types`.
bool covers(const Load& more, const Load& load, const std::set<std::string, std::less<>>& types) {
  return std::all_of(load.begin(), load.end(), [&](const auto& of) {
    if (of.second <= 0 || !types.contains(of.first)) return true;
    const auto found = more.find(of.first);
    return found != more.end() && found->second >= of.second;
  });
}

}  // namespace

std::set<std::string, std::less<>> stated_loads(const XNodeSpec& xnode, std::string_view on) {
  std::set<std::string, std::less<>> types;
  for (const BesideSpec& beside : xnode.beside)
    if (beside.on == on)
      for (const auto& [type, xpus] : beside.load) types.insert(type);
  return types;
}

std::optional<std::int64_t> wcet_beside(const XNodeSpec& xnode, std::string_view on,
                                        const Load& load) {
  const auto types = stated_loads(xnode, on);
  if (covers({}, load, types)) return xnode.wcet_on(on);
  std::optional<std::int64_t> least;
  for (const BesideSpec& beside : xnode.beside)
    if (beside.on == on && covers(beside.load, load, types) && (!least || beside.wcet_us < *least))
      least = beside.wcet_us;
  return least;
}

std::int64_t longest_wcet(const XNodeSpec& xnode, std::string_view on) {
  std::int64_t longest = xnode.wcet_on(on).value_or(0);
  for (const BesideSpec& beside : xnode.beside)
    if (beside.on == on) longest = std::max(longest, beside.wcet_us);
  return longest;
}

AppSpec at_longest(AppSpec app) {
  for (XNodeSpec& xnode : app.xnodes) {
    for (auto& [type, us] : xnode.wcet_us) us = longest_wcet(xnode, type);
    xnode.beside.clear();
  }
  return app;
}

Status validate_beside(const XNodeSpec& xnode, const std::string& where) {
  const std::string who = "XNode " + quoted(xnode.name);
  if (xnode.beside.size() > kMaxBeside)
    return invalid(who + " states more than " + std::to_string(kMaxBeside) + " loads", where);
  std::set<std::pair<std::string_view, Load>> seen;
  for (std::size_t k = 0; k < xnode.beside.size(); ++k) {
    const BesideSpec& beside = xnode.beside[k];
    const std::string at_load = where + "/" + std::to_string(k);
    const auto alone = xnode.wcet_on(beside.on);
    if (!alone)
      return invalid(who + " has no implementation for " + quoted(beside.on), at_load + "/on");
    if (beside.load.empty()) return invalid(who + ": a load of nothing", at_load + "/load");
    for (const auto& [type, xpus] : beside.load) {
      if (type.empty() || type.size() > kMaxNameBytes)
        return invalid(who + ": a load of an XPU type without name", at_load + "/load");
      if (xpus < 1 || xpus > static_cast<std::int64_t>(kMaxXpus))
        return invalid(
            who + ": " + std::to_string(xpus) + " XPUs are not 1 to " + std::to_string(kMaxXpus),
            at_load + "/load/" + type);
    }
    if (beside.wcet_us < *alone || beside.wcet_us > kMaxTimeUs)
      return invalid(who + ": " + std::to_string(beside.wcet_us) + " us beside " +
                         words_of(beside.load) + ", and " + std::to_string(*alone) +
                         " us alone: nothing is shorter beside a load",
                     at_load + "/wcet_us");
    if (!seen.emplace(beside.on, beside.load).second)
      return invalid(who + " states it beside " + words_of(beside.load) + " twice", at_load);
  }
  return {};
}

Status validate_beside_on(const AppSpec& app, const Platform& platform) {
  std::map<std::string, std::int64_t, std::less<>> able;  // XNodes with an implementation
  for (const XNodeSpec& x : app.xnodes)
    for (const auto& [type, us] : x.wcet_us) ++able[type];
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    if (x.beside.empty()) continue;
    for (const auto& [on, alone] : x.wcet_us) {
      if (platform.instances_of(on).empty()) continue;
      Load most;
      for (const std::string& type : stated_loads(x, on)) {
        const auto xpus = static_cast<std::int64_t>(platform.instances_of(type).size());
        const auto others = able.find(type);
        const std::int64_t number =
            std::min(xpus - (type == on ? 1 : 0),
                     others == able.end() ? 0 : others->second - (x.wcet_on(type) ? 1 : 0));
        if (number > 0) most[type] = number;
      }
      if (wcet_beside(x, on, most)) continue;
      return invalid("XNode " + quoted(x.name) + " on " + on + " may run beside " + words_of(most) +
                         ", of which no time is stated",
                     "/xnodes/" + std::to_string(i) + "/beside",
                     "`xauto profile --contended` measures it");
    }
  }
  return {};
}

std::int64_t counted_wcet_us(const AppSpec& app, const Platform& platform, const Policy& policy,
                             std::size_t i) {
  const Placement& placed = policy.placements[i];
  if (placed.wcet_us) return *placed.wcet_us;
  return app.xnodes[i].wcet_on(platform.xpus[at(placed.xpu)].type).value_or(0);
}

std::set<std::string, std::less<>> loads_not_stated(const AppSpec& app, const Platform& platform,
                                                    const Policy& policy) {
  std::vector<int> used;  // XPUs
  for (const Placement& placed : policy.placements) used.push_back(placed.xpu);
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  std::set<std::string, std::less<>> missing;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const int own = policy.placements[i].xpu;
    const auto stated = stated_loads(app.xnodes[i], platform.xpus[at(own)].type);
    for (const int xpu : used)
      if (const std::string& type = platform.xpus[at(xpu)].type;
          xpu != own && !stated.contains(type))
        missing.insert(type);
  }
  return missing;
}

std::string independence_of(const AppSpec& app, const Platform& platform, const Policy& policy) {
  std::string types;
  for (const std::string& type : loads_not_stated(app, platform, policy))
    types += (types.empty() ? "" : ", ") + type;
  if (types.empty()) return {};
  return "XPUs are independent: of some XNodes app.json states no time beside a load of " + types +
         " (`xauto profile --contended` measures them)";
}

std::string words_of(const Load& load) {
  std::string words;
  for (const auto& [type, xpus] : load)
    words += (words.empty() ? "" : ", ") + std::to_string(xpus) + " " + type;
  return words;
}

}  // namespace xauto

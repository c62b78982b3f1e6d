// SPDX-License-Identifier: Apache-2.0
#include "xpu/presence.h"

#include <algorithm>
#include <set>

#include <sys/stat.h>

#include "base/rt.h"

namespace xauto::xpu {

Hardware Hardware::here(const std::vector<Kind>& table) {
  Hardware machine{rt::allowed_cores().size(), {}};
  for (const Kind& kind : table) {
    std::set<std::string> numbers;  // two releases' nodes may be there at once
    for (const std::string& node : kind.nodes) {
      struct stat status {};
      if (stat(node.c_str(), &status) == 0)
        numbers.insert(node.substr(node.find_last_not_of("0123456789") + 1));
    }
    if (!numbers.empty()) machine.devices[kind.type] = kind.node_each ? numbers.size() : kMaxXpus;
  }
  return machine;
}

bool Hardware::has(const Platform& platform, std::size_t xpu,
                   const std::vector<Kind>& table) const {
  const Xpu& x = platform.xpus[xpu];
  std::size_t there = cores;
  if (!kind_of(x.type, table).nodes.empty()) {
    const auto counted = devices.find(x.type);
    there = counted == devices.end() ? 0 : counted->second;
  } else if (x.type != "cpu") {
    return true;
  }
  const std::vector<int> all = platform.instances_of(x.type);
  const auto at = std::find(all.begin(), all.end(), static_cast<int>(xpu));
  return static_cast<std::size_t>(at - all.begin()) < there;
}

std::string Hardware::lacks(const Xpu& xpu) const {
  if (xpu.type == "cpu")
    return "this process may use " + std::to_string(cores) + (cores == 1 ? " CPU" : " CPUs");
  if (const auto some = devices.find(xpu.type); some != devices.end())
    return "this machine has " + std::to_string(some->second) + " of type " + xpu.type;
  return "this machine has no " + xpu.type + " (no device node)";
}

Result<std::vector<Presence>> presence_of(const Platform& platform, const EmulationFlags& flags,
                                          const AppSpec* app, const Hardware& machine) {
  const std::vector<Xpu>& xpus = platform.xpus;
  const auto named = [&](const Xpu& xpu, const std::string& name) {
    return xpu.id == name || xpu.type == name;
  };
  for (const std::string& name : flags.names)
    if (std::none_of(xpus.begin(), xpus.end(), [&](const Xpu& x) { return named(x, name); }))
      return fail(ErrorCode::kInvalid,
                  "'" + name + "' is no XPU of platform '" + platform.name + "', nor a type",
                  "--emulate");
  std::vector<Presence> presence(xpus.size());
  bool emulates = false;
  for (std::size_t i = 0; i < xpus.size(); ++i) {
    const bool here = machine.has(platform, i);
    const Presence real = here ? Presence::kReal : Presence::kAbsent;
    if (flags.all || std::any_of(flags.names.begin(), flags.names.end(),
                                 [&](const std::string& name) { return named(xpus[i], name); })) {
      presence[i] = Presence::kEmulated;
    } else if (flags.none) {
      if (!here)
        return fail(ErrorCode::kUnavailable, xpus[i].id + " is not here: " + machine.lacks(xpus[i]),
                    "--real", "drop --real to emulate what is missing");
      presence[i] = Presence::kReal;
    } else if (xpus[i].emulated) {
      presence[i] = *xpus[i].emulated ? Presence::kEmulated : real;
    } else if (!flags.names.empty()) {
      presence[i] = real;
    } else {
      presence[i] = here ? Presence::kEither : Presence::kEmulated;
    }
    emulates = emulates || presence[i] == Presence::kEmulated;
  }
  for (std::size_t i = 0; i < xpus.size(); ++i) {
    if (presence[i] != Presence::kEither) continue;
    if (!emulates)
      presence[i] = Presence::kReal;
    else if (app != nullptr)
      presence[i] =
          std::any_of(app->xnodes.begin(), app->xnodes.end(),
                      [&](const XNodeSpec& x) { return x.real_on.contains(xpus[i].type); })
              ? Presence::kReal
              : Presence::kEmulated;
  }
  return presence;
}

Status check_placements(const AppSpec& app, const Platform& platform,
                        const std::vector<Presence>& presence, const PriorityPlan& policy,
                        const std::string& path) {
  const Hardware machine = Hardware::here();
  const char* hint =
      "xauto doctor --platform-out here.json writes a platform file of this machine: profile and "
      "solve with that";
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const XNodeSpec& xnode = app.xnodes[i];
    const auto at = static_cast<std::size_t>(policy.placements[i].xpu);
    const Xpu& xpu = platform.xpus[at];
    const std::string where = path + ": XNode '" + xnode.name + "'";
    if (presence[at] == Presence::kAbsent)
      return fail(ErrorCode::kInvalid,
                  "is placed on " + xpu.id + ", which is not here: " + machine.lacks(xpu), where,
                  hint);
    // An emulated core that this machine has was asked for: what `init` returns there is seen soon.
    if (presence[at] == Presence::kEmulated && xpu.type == "cpu" && xnode.real_on.contains("cpu") &&
        !machine.has(platform, at))
      return fail(ErrorCode::kInvalid,
                  "computes itself (real_on in app.json) and is placed on " + xpu.id +
                      ", which this machine lacks: " + machine.lacks(xpu),
                  where, hint);
  }
  return {};
}

Status check_placements(const AppSpec& app, const Platform& platform,
                        const std::vector<Presence>& presence, const Tables& tables,
                        const std::string& path) {
  for (std::size_t t = 0; t < tables.tables.size(); ++t)
    XAUTO_TRY(check_placements(app, platform, presence, whole_policy(tables, t, app, platform),
                               path + ": table '" + tables.tables[t].name + "'"));
  return {};
}

std::string ids_of(const Platform& platform, const std::vector<Presence>& presence,
                   Presence which) {
  std::string ids;
  for (std::size_t i = 0; i < presence.size(); ++i)
    if (presence[i] == which) ids += (ids.empty() ? "" : ", ") + platform.xpus[i].id;
  return ids;
}

std::string describe(const Platform& platform, const std::vector<Presence>& presence) {
  const std::string emulated = ids_of(platform, presence, Presence::kEmulated);
  if (emulated.empty()) return {};
  if (std::all_of(presence.begin(), presence.end(),
                  [](Presence p) { return p == Presence::kEmulated; }))
    return "emulated";
  std::string text;
  for (const auto& [which, word] : {std::pair{Presence::kReal, "real: "},
                                    {Presence::kEither, "real or emulated: "},
                                    {Presence::kEmulated, "emulated: "},
                                    {Presence::kAbsent, "not here: "}})
    if (const std::string ids = ids_of(platform, presence, which); !ids.empty())
      text += (text.empty() ? "" : "; ") + std::string(word) + ids;
  return text;
}

Platform platform_of(const Hardware& machine, const std::string& name,
                     const std::vector<Kind>& table) {
  Platform platform;
  platform.name = name;
  for (const Kind& kind : table) {
    if (kind.type == "cpu")
      for (std::size_t i = 0; i < std::min(machine.cores, kMaxXpus - 4 * table.size()); ++i)
        platform.xpus.push_back({"cpu" + std::to_string(i), "cpu"});
    if (kind.nodes.empty() || &kind_of(kind.type, table) != &kind) continue;
    const auto there = machine.devices.find(kind.type);
    const bool here = there != machine.devices.end();
    if (!here && kind.ways.empty()) continue;  // what stands in for it is an XPU of another type
    for (std::size_t i = 0; i < (here && kind.node_each ? there->second : 1); ++i) {
      Xpu xpu{kind.type + std::to_string(i), kind.type, !kind.ways.empty(), kind.preempt_us,
              kind.timeslice_us};
      xpu.preempt_measured = kind.measured;
      if (!here) {
        xpu.emulated = true;
      } else if (const int levels = levels_to_state(kind); levels >= 2) {
        xpu.levels = levels;
        if (kind.ways.front().ask != nullptr) xpu.preempt_us = 0;  // `profile` has it in the WCETs
      } else if (const Way* way = way_of(kind); way != nullptr && way->levels != nullptr) {
        xpu.preemptive = false;
      }
      platform.xpus.push_back(std::move(xpu));
    }
  }
  return platform;
}

}  // namespace xauto::xpu

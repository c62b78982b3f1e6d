// SPDX-License-Identifier: Apache-2.0
#include "xauto/emulation.h"

#include <algorithm>
#include <sstream>

#include "base/log.h"

namespace xauto::cli {

void EmulationOptions::declare(Verb verb) {
  emulate_ = verb.option("--emulate", names_,
                         "emulate these types or XPUs (gpu,dla), and have the others real; "
                         "without names all. Default: what this machine lacks, and what the "
                         "app only has stand-ins for")
                 .value_may_miss("XPU,...");
  verb.flag("--real", real_, "refuse to emulate").excludes("--emulate");
}

Result<std::vector<Presence>> EmulationOptions::decide(const Platform& platform,
                                                       const AppSpec* app) const {
  xpu::EmulationFlags flags;
  flags.none = real_;
  std::istringstream names(names_);
  for (std::string name; std::getline(names, name, ',');)
    if (!name.empty()) flags.names.push_back(name);
  flags.all = all_asked || (emulate_->given() && flags.names.empty());
  const xpu::Machine machine = xpu::Machine::here();
  XAUTO_ASSIGN(std::vector<Presence> presence, xpu::presence_of(platform, flags, app, machine));
  std::string why;
  for (std::size_t i = 0; i < presence.size() && why.empty(); ++i)
    if (!machine.has(platform, i) && presence[i] != Presence::kReal)
      why = ": " + machine.lacks(platform.xpus[i]);
  if (const std::string said = xpu::describe(platform, presence); said == "emulated")
    log::info("emulating platform '{}'{}", platform.name, why);
  else if (!said.empty())
    log::info("platform '{}': {}{}", platform.name, said, why);
  return presence;
}

std::string in_parentheses(const Platform& platform, const std::vector<Presence>& presence) {
  const std::string said = xpu::describe(platform, presence);
  return said.empty() ? "" : " (" + said + ")";
}

}  // namespace xauto::cli

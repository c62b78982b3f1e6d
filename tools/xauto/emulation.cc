// SPDX-License-Identifier: Apache-2.0
#include "xauto/emulation.h"

#include <sstream>

#include "base/log.h"
#include "model/json.h"

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
  const xpu::Hardware machine = xpu::Hardware::here();
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

Result<EmulationScript> load_script(const std::string& path, const Platform& platform,
                                    const std::vector<Presence>& presence) {
  XAUTO_ASSIGN(EmulationScript script, load_emulation_script(path, platform));
  Platform emulated{platform.name, {}};
  for (std::size_t x = 0; x < platform.xpus.size(); ++x)
    if (presence[x] == Presence::kEmulated || presence[x] == Presence::kEither)
      emulated.xpus.push_back(platform.xpus[x]);
  if (Status fits = validate(script, emulated); !fits)
    return fail(ErrorCode::kInvalid, "tells of an XPU that is not emulated in this run",
                path + ": " + fits.error().where, "see --emulate");
  return script;
}

std::string in_parentheses(const Platform& platform, const std::vector<Presence>& presence) {
  const std::string said = xpu::describe(platform, presence);
  return said.empty() ? "" : " (" + said + ")";
}

}  // namespace xauto::cli

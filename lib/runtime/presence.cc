// SPDX-License-Identifier: Apache-2.0
#include "runtime/presence.h"

#include <algorithm>

#include <sys/stat.h>

#include "base/rt.h"

namespace xauto::runtime {

Machine Machine::here() {
  struct stat status {};
  const auto there = [&](const char* path) { return stat(path, &status) == 0; };
  return {rt::allowed_cores().size(), there("/dev/nvgpu/igpu0/tsg") || there("/dev/nvhost-tsg-gpu"),
          there("/dev/nvhost-ctrl-nvdla0") || there("/dev/nvdla0")};
}

bool Machine::has(const Platform& platform, std::size_t xpu) const {
  const Xpu& x = platform.xpus[xpu];
  if (x.type == "gpu") return gpu;
  if (x.type == "dla") return dla;
  if (x.type != "cpu") return true;
  const std::vector<int> cpus = platform.instances_of("cpu");
  const auto at = std::find(cpus.begin(), cpus.end(), static_cast<int>(xpu));
  return static_cast<std::size_t>(at - cpus.begin()) < cores;
}

std::string Machine::lacks(const Xpu& xpu) const {
  if (xpu.type == "cpu")
    return "this process may use " + std::to_string(cores) + (cores == 1 ? " CPU" : " CPUs");
  return "this machine has no " + xpu.type + " (no device node)";
}

Result<std::vector<Presence>> presence_of(const Platform& platform, const EmulationFlags& flags,
                                          const AppSpec* app, const Machine& machine) {
  const std::vector<Xpu>& xpus = platform.xpus;
  const auto named = [&](const Xpu& xpu, const std::string& name) {
    return xpu.id == name || xpu.type == name;
  };
  for (const std::string& name : flags.names)
    if (std::none_of(xpus.begin(), xpus.end(), [&](const Xpu& x) { return named(x, name); }))
      return fail(ErrorCode::kInvalid,
                  "'" + name + "' is no XPU of platform '" + platform.name + "', nor a type",
                  "--emulate");
  std::vector<Presence> presence(xpus.size(), Presence::kEither);
  bool emulates = false;
  for (std::size_t i = 0; i < xpus.size(); ++i) {
    const bool here = machine.has(platform, i);
    const Presence real = here ? Presence::kReal : Presence::kAbsent;
    if (flags.all) {
      presence[i] = Presence::kEmulated;
    } else if (std::any_of(flags.names.begin(), flags.names.end(),
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
    } else if (!here) {
      presence[i] = Presence::kEmulated;
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

Status check_emulated(const SchedHandle& handle, const std::string& xpu, const std::string& where) {
  using Kind = SchedHandle::Kind;
  if (handle.kind() == Kind::kEmulated) return {};
  const char* what = handle.kind() == Kind::kThread        ? "SchedHandle::thread()"
                     : handle.kind() == Kind::kCudaContext ? "SchedHandle::cuda_context()"
                     : handle.kind() == Kind::kCudlaDevice ? "SchedHandle::cudla_device()"
                                                           : "SchedHandle::gate()";
  return fail(ErrorCode::kInvalid,
              std::string("returned ") + what + ", it computes itself, and " + xpu +
                  " is emulated in this run",
              where,
              handle.kind() == Kind::kThread
                  ? "name what shall be emulated, and the CPUs are real: --emulate gpu,dla; or "
                    "profile again: app.json then says where it computes itself"
                  : "on an emulated XPU `init` returns emu::Context::handle()");
}

Platform platform_of(const Machine& machine, const std::string& name) {
  const Platform small = *Platform::builtin("small");
  Platform platform;
  platform.name = name;
  for (std::size_t i = 0; i < std::min(machine.cores, kMaxXpus - 2); ++i)
    platform.xpus.push_back({"cpu" + std::to_string(i), "cpu"});
  for (const Xpu& xpu : small.xpus) {
    if (xpu.type == "cpu") continue;
    platform.xpus.push_back(xpu);
    if (!(xpu.type == "gpu" ? machine.gpu : machine.dla)) platform.xpus.back().emulated = true;
  }
  return platform;
}

}  // namespace xauto::runtime

// SPDX-License-Identifier: Apache-2.0
#include "model/platform.h"

#include <algorithm>
#include <set>

namespace xauto {

int Platform::find(std::string_view id) const {
  for (std::size_t i = 0; i < xpus.size(); ++i)
    if (xpus[i].id == id) return static_cast<int>(i);
  return -1;
}

int Platform::find_host(std::string_view host) const {
  for (std::size_t h = 0; h < hosts.size(); ++h)
    if (hosts[h].name == host) return static_cast<int>(h);
  return -1;
}

const HostLink* Platform::link(int from, int to) const {
  for (const HostLink& link : links)
    if (link.from == from && link.to == to) return &link;
  return nullptr;
}

std::vector<int> Platform::instances_of(std::string_view type) const {
  std::vector<int> found;
  for (std::size_t i = 0; i < xpus.size(); ++i)
    if (xpus[i].type == type) found.push_back(static_cast<int>(i));
  return found;
}

std::vector<std::string> Platform::types() const {
  std::vector<std::string> found;
  for (const Xpu& xpu : xpus)
    if (std::find(found.begin(), found.end(), xpu.type) == found.end()) found.push_back(xpu.type);
  return found;
}

namespace {

/// What a built-in platform has. `measured`: the paper's costs are this machine's.
struct Board {
  const char* name;
  int cpus, dlas, vics, pvas;
  bool measured;
};
/// small and large: section 6.1. Boards: NVIDIA's data sheets of the modules. Of VICs and PVAs Linux's device trees
/// have one each, an Orin Nano no PVA, and Thor no DLA. A Xavier has two PVAs: VPI alone says which one works, so one
/// is planned.
constexpr Board kBoards[] = {
    {"small", 4, 1, 0, 0, true},    {"large", 8, 2, 0, 0, true},      {"orin", 12, 2, 1, 1, true},
    {"orin-nx", 8, 2, 1, 1, false}, {"orin-nano", 6, 0, 1, 0, false}, {"xavier", 8, 2, 1, 1, false},
    {"thor", 14, 0, 1, 1, false},
};
constexpr std::int64_t kGpuPreemptUs = 275, kDlaPreemptUs = 132,
                       kSliceUs = 1000;  // the paper's, of an Orin

void add(Platform& platform, const char* type, int count, const Xpu& like) {
  for (int i = 0; i < count; ++i) {
    platform.xpus.push_back(like);
    platform.xpus.back().type = type;
    platform.xpus.back().id = type + std::to_string(i);
  }
}

}  // namespace

Result<Platform> Platform::builtin(std::string_view name) {
  Platform platform;
  platform.name = name;
  const Xpu gated{.preemptive = false};
  Xpu gpu{.preempt_us = kGpuPreemptUs, .timeslice_us = kSliceUs};
  if (name == "core-ultra") {
    add(platform, "cpu", 6, {});
    gpu.levels = 3;
    gpu.preempt_measured = false;
    add(platform, "gpu", 1, gpu);
    add(platform, "npu", 1, {.preemptive = false, .timeslice_us = kSliceUs});
    return platform;
  }
  const auto* const board =
      std::ranges::find_if(kBoards, [&](const Board& b) { return name == b.name; });
  if (board == std::end(kBoards))
    return fail(ErrorCode::kNotFound, "no built-in platform '" + std::string(name) + "'", {},
                std::string("use ") + kPlatformNames);
  gpu.preempt_measured = board->measured;
  add(platform, "cpu", board->cpus, {});
  add(platform, "gpu", 1, gpu);
  add(platform, "dla", board->dlas,
      {.preempt_us = kDlaPreemptUs, .timeslice_us = kSliceUs, .preempt_measured = board->measured});
  add(platform, "vic", board->vics, gated);
  add(platform, "pva", board->pvas, gated);
  return platform;
}

std::string unmeasured(const Xpu& xpu) {
  if (!xpu.preemptive || xpu.preempt_measured) return {};
  return xpu.id + ": that a preemption costs at most " + std::to_string(xpu.preempt_us) +
         " us: nobody has measured it on this platform; " +
         (xpu.levels > 0 ? "`xauto profile` times jobs beside less urgent ones"
                         : "a run compares it with what suspending takes");
}

namespace {

Status validate_hosts(const Platform& platform) {
  const std::size_t count = platform.hosts.size();
  if (count == 1 || count > kMaxHosts)
    return fail(ErrorCode::kInvalid,
                std::to_string(count) + " hosts; 2 to " + std::to_string(kMaxHosts) +
                    " are possible, or none",
                "/hosts");
  std::set<std::string> names;
  for (std::size_t h = 0; h < count; ++h) {
    const Host& host = platform.hosts[h];
    const std::string at = "/hosts/" + std::to_string(h);
    if (host.name.empty()) return fail(ErrorCode::kInvalid, "a host needs a name", at + "/name");
    if (!names.insert(host.name).second)
      return fail(ErrorCode::kInvalid, "two hosts are called '" + host.name + "'", at + "/name");
    if (host.rate_ppm < 0 || host.rate_ppm > kMaxHostPpm)
      return fail(
          ErrorCode::kInvalid,
          std::to_string(host.rate_ppm) + " is not in 0 to " + std::to_string(kMaxHostPpm) + " ppm",
          at + "/rate_ppm");
    if (std::ranges::none_of(platform.xpus,
                             [&](const Xpu& x) { return x.host == static_cast<int>(h); }))
      return fail(ErrorCode::kInvalid, "host '" + host.name + "' has no XPU", at + "/name");
  }
  const auto is_host = [&](int host) {
    return host >= 0 && static_cast<std::size_t>(host) < count;
  };
  for (std::size_t i = 0; i < platform.xpus.size(); ++i)
    if (count > 0 ? !is_host(platform.xpus[i].host) : platform.xpus[i].host != 0)
      return fail(ErrorCode::kInvalid, "XPU '" + platform.xpus[i].id + "' is on no host",
                  "/xpus/" + std::to_string(i) + "/host");
  std::set<std::pair<int, int>> ways;
  for (std::size_t l = 0; l < platform.links.size(); ++l) {
    const HostLink& link = platform.links[l];
    const std::string at = "/links/" + std::to_string(l);
    if (!is_host(link.from) || !is_host(link.to) || link.from == link.to)
      return fail(ErrorCode::kInvalid, "a link leads from one host to another one", at);
    if (!ways.insert({link.from, link.to}).second)
      return fail(ErrorCode::kInvalid,
                  "a second link from '" +
                      platform.hosts[static_cast<std::size_t>(link.from)].name + "' to '" +
                      platform.hosts[static_cast<std::size_t>(link.to)].name + "'",
                  at, "state the one that messages take");
    if (link.base_us < 0 || link.base_us > kMaxTimeUs)
      return fail(ErrorCode::kInvalid,
                  std::to_string(link.base_us) + " is not a time from 0 to " +
                      std::to_string(kMaxTimeUs) + " us",
                  at + "/base_us");
    if (link.mbit_s < 0 || link.mbit_s > kMaxMbitS)
      return fail(
          ErrorCode::kInvalid,
          std::to_string(link.mbit_s) + " is not in 0 to " + std::to_string(kMaxMbitS) + " Mbit/s",
          at + "/mbit_s");
  }
  return {};
}

}  // namespace

Status validate(const Platform& platform) {
  if (platform.xpus.empty() || platform.xpus.size() > kMaxXpus)
    return fail(ErrorCode::kInvalid,
                std::to_string(platform.xpus.size()) + " XPUs; 1 to " + std::to_string(kMaxXpus) +
                    " are possible",
                "/xpus");
  std::set<std::string> ids;
  for (std::size_t i = 0; i < platform.xpus.size(); ++i) {
    const Xpu& xpu = platform.xpus[i];
    const std::string at = "/xpus/" + std::to_string(i);
    if (xpu.id.empty()) return fail(ErrorCode::kInvalid, "an XPU needs a name", at + "/id");
    if (xpu.type.empty())
      return fail(ErrorCode::kInvalid, "XPU '" + xpu.id + "' needs a type", at + "/type");
    if (xpu.type == kEveryType)
      return fail(ErrorCode::kInvalid, "'*' is no name of a type: it is all of them", at + "/type");
    if (!ids.insert(xpu.id).second)
      return fail(ErrorCode::kInvalid, "two XPUs are called '" + xpu.id + "'", at + "/id");
    const auto in_range = [](std::int64_t us, std::int64_t low) {
      return us >= low && us <= kMaxTimeUs;
    };
    if (!in_range(xpu.preempt_us, 0))
      return fail(ErrorCode::kInvalid,
                  std::to_string(xpu.preempt_us) + " is not a time from 0 to " +
                      std::to_string(kMaxTimeUs) + " us",
                  at + "/preempt_us");
    if (!in_range(xpu.timeslice_us, 0))
      return fail(ErrorCode::kInvalid,
                  std::to_string(xpu.timeslice_us) + " is not a time from 0 to " +
                      std::to_string(kMaxTimeUs) + " us",
                  at + "/timeslice_us");
    if (!in_range(xpu.switch_us, -1))
      return fail(ErrorCode::kInvalid,
                  std::to_string(xpu.switch_us) + " is not a time from 0 to " +
                      std::to_string(kMaxTimeUs) + " us",
                  at + "/switch_us");
    if (xpu.levels != 0 && (xpu.levels < 2 || xpu.levels > kMaxLevels))
      return fail(ErrorCode::kInvalid,
                  std::to_string(xpu.levels) + " is not a number of levels from 2 to " +
                      std::to_string(kMaxLevels),
                  at + "/levels",
                  xpu.levels == 1 ? "with one level it is \"preemptive\": false" : "");
    if (xpu.levels != 0 && !xpu.preemptive)
      return fail(ErrorCode::kInvalid, "XPU '" + xpu.id + "' has levels and is not preemptive",
                  at + "/levels", "by levels the hardware preempts: leave one of the two out");
  }
  return validate_hosts(platform);
}

const char* to_string(Discipline discipline) {
  switch (discipline) {
    case Discipline::kPreemptive:
      return "preemptive";
    case Discipline::kGate:
      return "gate";
    case Discipline::kKernel:
      return "kernel";
    case Discipline::kLevels:
      return "levels";
  }
  return "?";
}

}  // namespace xauto

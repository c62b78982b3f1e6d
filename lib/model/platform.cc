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

Result<Platform> Platform::builtin(std::string_view name) {
  const auto add_cpus = [](Platform& platform, int count) {
    for (int i = 0; i < count; ++i)
      platform.xpus.push_back({"cpu" + std::to_string(i), "cpu", true, 0, 0, -1});
  };
  Platform platform;
  platform.name = name;
  if (name == "core-ultra") {
    add_cpus(platform, 6);
    platform.xpus.push_back({"gpu0", "gpu", true, 275, 1000, -1, 3});
    platform.xpus.push_back({"npu0", "npu", false, 0, 1000, -1});
    return platform;
  }
  int cpus = 0, dlas = 0;
  if (name == "small") {
    cpus = 4;
    dlas = 1;
  } else if (name == "large") {
    cpus = 8;
    dlas = 2;
  } else {
    return fail(ErrorCode::kNotFound, "no built-in platform '" + std::string(name) + "'", {},
                std::string("use ") + kPlatformNames);
  }
  add_cpus(platform, cpus);
  platform.xpus.push_back({"gpu0", "gpu", true, 275, 1000, -1});
  for (int i = 0; i < dlas; ++i)
    platform.xpus.push_back({"dla" + std::to_string(i), "dla", true, 132, 1000, -1});
  return platform;
}

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
  return {};
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

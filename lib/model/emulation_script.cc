// SPDX-License-Identifier: Apache-2.0
#include "model/emulation_script.h"

#include <algorithm>
#include <set>

namespace xauto {
namespace {

using Percents = std::map<std::string, std::int64_t, std::less<>>;

Status valid_percents(const Percents& percents, std::int64_t low, std::int64_t high,
                      const std::vector<std::string>& types, const std::string& at) {
  for (const auto& [type, pct] : percents) {
    if (std::find(types.begin(), types.end(), type) == types.end())
      return fail(ErrorCode::kInvalid, "the platform has no XPU of type '" + type + "'",
                  at + "/" + type);
    if (pct < low || pct > high)
      return fail(ErrorCode::kInvalid,
                  std::to_string(pct) + " is not a percentage from " + std::to_string(low) +
                      " to " + std::to_string(high),
                  at + "/" + type);
  }
  return {};
}

Status valid_names(const std::vector<std::string>& names, const Platform& platform,
                   std::set<std::string>& named, const std::string& at) {
  for (std::size_t n = 0; n < names.size(); ++n) {
    const std::string where = at + "/" + std::to_string(n);
    if (platform.find(names[n]) < 0)
      return fail(ErrorCode::kInvalid, "the platform has no XPU '" + names[n] + "'", where);
    if (!named.insert(names[n]).second)
      return fail(ErrorCode::kInvalid, "XPU '" + names[n] + "' is named twice in this step", where);
  }
  return {};
}

}  // namespace

Status validate(const EmulationScript& script, const Platform& platform) {
  if (script.steps.empty() || script.steps.size() > kMaxEmulationSteps)
    return fail(ErrorCode::kInvalid,
                std::to_string(script.steps.size()) + " steps; 1 to " +
                    std::to_string(kMaxEmulationSteps) + " are possible",
                "/steps");
  const std::vector<std::string> types = platform.types();
  std::int64_t before = -1;
  for (std::size_t k = 0; k < script.steps.size(); ++k) {
    const EmulationStep& step = script.steps[k];
    const std::string here = "/steps/" + std::to_string(k);
    if (step.at_us < 0 || step.at_us > kMaxTimeUs)
      return fail(ErrorCode::kInvalid,
                  std::to_string(step.at_us) + " is not a time from 0 to " +
                      std::to_string(kMaxTimeUs) + " us",
                  here + "/at_us");
    if (step.at_us <= before)
      return fail(ErrorCode::kInvalid, "is not after the step before it", here + "/at_us",
                  "steps stand in the order of their times, one for each time");
    before = step.at_us;
    if (step.speed_pct.empty() && step.contention_pct.empty() && step.stop.empty() &&
        step.start.empty())
      return fail(ErrorCode::kInvalid, "changes nothing", here,
                  "a step has speed_pct, contention_pct, stop or start");
    XAUTO_TRY(valid_percents(step.speed_pct, 1, kMaxSpeedPct, types, here + "/speed_pct"));
    XAUTO_TRY(
        valid_percents(step.contention_pct, 0, kMaxContentionPct, types, here + "/contention_pct"));
    std::set<std::string> named;
    XAUTO_TRY(valid_names(step.stop, platform, named, here + "/stop"));
    XAUTO_TRY(valid_names(step.start, platform, named, here + "/start"));
  }
  if (script.repeat_us == 0) return {};
  if (script.repeat_us < kMinRepeatUs || script.repeat_us > kMaxTimeUs)
    return fail(ErrorCode::kInvalid,
                std::to_string(script.repeat_us) + " is not a time from " +
                    std::to_string(kMinRepeatUs) + " to " + std::to_string(kMaxTimeUs) + " us",
                "/repeat_us");
  if (script.repeat_us <= before)
    return fail(ErrorCode::kInvalid, "must be after the last step", "/repeat_us");
  return {};
}

}  // namespace xauto

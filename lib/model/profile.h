// SPDX-License-Identifier: Apache-2.0
// Profile: what the profiler measured, per XNode and XPU instance. File: profile.json.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// Summary of `count` execution times of one XNode alone on one XPU instance, warm-up left out.
struct Samples {
  std::int64_t count = 0;
  std::int64_t min_us = 0, p50_us = 0, p99_us = 0, max_us = 0;
  bool operator==(const Samples&) const = default;
};

struct XNodeProfile {
  std::string name;
  std::string module;
  std::map<std::string, Samples, std::less<>> on;  ///< XPU instance id -> samples
  std::vector<int> sources = {};                   ///< as XNodeSpec::sources
  bool operator==(const XNodeProfile&) const = default;
};

/// Under what conditions the times hold. A profile taken under others must not be trusted silently.
struct ProfileConditions {
  std::string machine;   ///< uname nodename / CPU model
  std::string platform;  ///< Platform::name
  bool emulated = false;
  std::string input;  ///< recorded input that was replayed
  std::int64_t warmup = 0;
  std::int64_t repetitions = 0;
  std::string governor;  ///< cpufreq governor, empty if unknown
  bool operator==(const ProfileConditions&) const = default;
};

struct Profile {
  std::string app;
  ProfileConditions conditions;
  std::int64_t margin_pct = 20;  ///< WCET = max * (1 + margin)
  std::vector<XNodeProfile> xnodes;
  std::vector<std::pair<int, int>> edges;  ///< as AppSpec::edges
  std::vector<SourceSpec> sources = {};    ///< as AppSpec::sources
  bool operator==(const Profile&) const = default;
};

[[nodiscard]] Status validate(const Profile& profile);

/// Which statistic of the samples becomes the WCET of app.json.
enum class WcetFrom { kMaxPlusMargin, kP99, kP50 };
/// The app.json that follows: per XPU type the worst instance's statistic. `platform` gives each
/// instance its type.
[[nodiscard]] Result<AppSpec> to_app(const Profile& profile, const Platform& platform,
                                     WcetFrom from);

}  // namespace xauto

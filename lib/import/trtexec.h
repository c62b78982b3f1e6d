// SPDX-License-Identifier: Apache-2.0
// What TensorRT's trtexec measured of an engine: --exportTimes, --exportProfile. Their keys: NVIDIA/TensorRT,
// samples/common/sampleReporting.cpp (exportJSONTrace, Profile::exportJSONProfile).
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

namespace xauto::import {

struct EngineTimes {
  std::string xnode, type;             ///< of whom, and on which XPU type
  std::vector<std::int64_t> times_us;  ///< of each inference, copies to and from the XPU included
};

struct EngineLayer {
  std::string name;
  double average_us = 0;
};

inline constexpr std::size_t kMaxInferences = 2'000'000, kMaxLayers = 100'000, kMaxStages = 64;
inline constexpr std::size_t kMaxTrtexecBytes = 64u << 20;

/// Errors: not what --exportTimes writes; no inference.
[[nodiscard]] Result<std::vector<std::int64_t>> parse_trtexec_times(std::string_view text,
                                                                    const std::string& origin);
/// Errors: not what --exportProfile writes; no layer that takes time.
[[nodiscard]] Result<std::vector<EngineLayer>> parse_trtexec_profile(std::string_view text,
                                                                     const std::string& origin);

/// Gives XNodes of the app implementations with the longest of these times and `margin_pct` more; `lines` tells median,
/// p99 and longest. Errors: no such XNode.
[[nodiscard]] Status add_engines(const std::vector<EngineTimes>& engines, std::int64_t margin_pct,
                                 ImportedApp& into, std::vector<std::string>& lines);

/// An app of these nets alone: each a module that hears of one source, which states no rate.
[[nodiscard]] ImportedApp app_of_engines(const std::vector<EngineTimes>& engines,
                                         const std::string& name);

/// Cuts the XNode of an app of nets into at most `stages`, between layers, so that the longest is as short as may be;
/// each takes its layers' part of the whole on every type. Errors: no such XNode, edges of it.
[[nodiscard]] Status cut_at_layers(const std::string& xnode, const std::vector<EngineLayer>& layers,
                                   std::size_t stages, ImportedApp& into,
                                   std::vector<std::string>& lines);

}  // namespace xauto::import

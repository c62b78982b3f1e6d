// SPDX-License-Identifier: Apache-2.0
// EmulationScript: what happens to the emulated XPUs while a run goes on: clocks change, busy XPUs
// slow each other down, an XPU stops. File: emulation.json. Value types; `validate` says whether they
// make sense, and every reader calls it. What the emulator makes of it: emu/machine.h.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/platform.h"

namespace xauto {

/// What changes at one instant; what is not said stays as it is.
struct EmulationStep {
  std::int64_t at_us = 0;  ///< since the first work that the emulator was given
  /// XPU type -> percent of the nominal speed at which work progresses; 100 at the beginning.
  std::map<std::string, std::int64_t, std::less<>> speed_pct = {};
  /// XPU type -> percent that work there takes longer per other busy XPU of a type with contention;
  /// 0, none, at the beginning.
  std::map<std::string, std::int64_t, std::less<>> contention_pct = {};
  std::vector<std::string> stop = {};   ///< XPUs, by id, on which nothing progresses any more
  std::vector<std::string> start = {};  ///< XPUs that go on
  bool operator==(const EmulationStep&) const = default;
};

struct EmulationScript {
  std::vector<EmulationStep> steps;
  /// The script begins again, from nominal XPUs, every so often; 0: it is played once.
  std::int64_t repeat_us = 0;
  bool operator==(const EmulationScript&) const = default;
};

inline constexpr std::size_t kMaxEmulationSteps = 1000;
inline constexpr std::int64_t kMinRepeatUs = 10'000;  ///< bounds the changes per second
inline constexpr std::int64_t kMaxSpeedPct = 1000, kMaxContentionPct = 1000;

/// 1 to kMaxEmulationSteps steps in the order of their times, which differ, are at most kMaxTimeUs and
/// before repeat_us, which is 0 or from kMinRepeatUs; types and XPUs of the platform; speeds from 1 to
/// kMaxSpeedPct, contentions from 0 to kMaxContentionPct; each step changes something, and names an XPU
/// once.
[[nodiscard]] Status validate(const EmulationScript& script, const Platform& platform);

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// Execution times of the Driving Case, in microseconds: a reconstruction, not a measurement. Only
// three end-to-end latencies are published; how these times follow from them: docs/driving-case.md.
#pragma once

namespace driving {

struct Stage {
  const char* xnode;
  const char* module;
  int cpu_us, gpu_us, dla_us;  ///< 0: no implementation
};

inline constexpr Stage kStages[] = {
    {"la.pre", "LA", 500, 0, 0},          {"la.infer", "LA", 0, 3000, 5100},
    {"la.post", "LA", 2800, 0, 0},        {"td.pre", "TD", 3500, 0, 0},
    {"td.infer", "TD", 0, 5600, 9000},    {"td.post", "TD", 1100, 0, 0},
    {"tc.infer", "TC", 0, 3300, 6700},    {"tc.post", "TC", 2300, 0, 0},
    {"fcd.pre", "FCD", 1000, 0, 0},       {"fcd.infer", "FCD", 0, 6000, 9400},
    {"fcd.post", "FCD", 1400, 0, 0},      {"rcd.pre", "RCD", 1600, 0, 0},
    {"rcd.infer", "RCD", 0, 5800, 10400}, {"rcd.post", "RCD", 1000, 0, 0},
    {"ld.pre", "LD", 3200, 0, 0},         {"ld.infer", "LD", 0, 7900, 19400},
    {"ld.post", "LD", 500, 0, 0},         {"tr.track", "TR", 3300, 0, 0},
    {"pr.predict", "PR", 2900, 0, 0},
};

/// Of driving-rates alone, and made up: what steers by all of it.
inline constexpr Stage kControlStages[] = {{"ctl.plan", "CTL", 2000, 0, 0},
                                           {"ctl.act", "CTL", 300, 0, 0}};

}  // namespace driving

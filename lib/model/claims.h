// SPDX-License-Identifier: Apache-2.0
// What our numbers are about, in words. Said wherever people see the number, in one way.
#pragma once

namespace xauto {

/// Policy::worst_case_us bounds the end-to-end latency of ...
inline constexpr const char* kWorstCaseScope =
    "a release that meets no other, its sources in phase, every job within its WCET";

/// ChainClaim::worst_case_us bounds the reduced reaction time of ...
inline constexpr const char* kKeyScope =
    "every release, for as long as the app runs, within its WCETs, jitters and clock tolerances, "
    "where "
    "each XPU runs the ready job with the smallest key";

}  // namespace xauto

// SPDX-License-Identifier: Apache-2.0
// SCHED_FIFO priorities of the threads on a core that follows keys.
#pragma once

namespace xauto {

/// Who says START has kCpuAsks. One whose run is not trusted, and to whom the machine's coordinator gives the core, is
/// below those that are: it may leave that core, since each process chooses the CPUs of its threads.
inline constexpr int kCpuLowered = 1, kCpuRegulated = 2, kCpuAdmitted = 3, kCpuAsks = 4;

}  // namespace xauto

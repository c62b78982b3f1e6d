// SPDX-License-Identifier: Apache-2.0
// What `xauto top --record` saw of the CPUs, as a Perfetto file of a track per CPU. Its tracks have
// numbers of their own: put behind a run's file (`cat run.pftrace cpus.pftrace`) both are one
// picture, on one clock. Pure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace xauto::story {

/// One event of the kernel's tracer, with its names found.
struct CpuStep {
  std::int64_t ts_ns = 0;
  std::uint16_t kind = 0;  ///< XAUTO_BPF_EV_*
  std::uint16_t cpu = 0;
  std::uint32_t tid = 0;
  std::string xnode;      ///< "-": none yet
  std::int64_t job = -1;  ///< the activation's number; -1: none yet
  std::int64_t delta_ns = 0;
  std::string by;  ///< who woke it, who has the CPU now
};

/// Steps by time. What has no beginning or no end in the trace is cut to it.
[[nodiscard]] std::string cpu_trace(const std::string& title, const std::vector<CpuStep>& steps,
                                    std::uint64_t lost, std::int64_t clock_offset_ns);

}  // namespace xauto::story

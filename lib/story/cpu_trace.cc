// SPDX-License-Identifier: Apache-2.0
#include "story/cpu_trace.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>
#include <uapi/xauto/bpf.h>

#include "story/perfetto.h"

namespace xauto::story {
namespace {

constexpr std::uint32_t kSequence = 2;  ///< a run's own file is 1

/// A thread on a CPU, from one switch to the next.
struct Stay {
  std::int64_t begin_ns = 0, end_ns = 0, waited_ns = 0, job = -1;
  std::uint32_t tid = 0;
  std::string xnode, woken_by, preempted_by;
};

std::map<std::uint16_t, std::vector<Stay>> stays_of(const std::vector<CpuStep>& steps) {
  std::map<std::uint16_t, std::vector<Stay>> stays;
  std::map<std::uint16_t, bool> open;
  std::map<std::uint32_t, std::string> woken_by;
  std::int64_t last = 0;
  for (const CpuStep& step : steps) {
    last = std::max(last, step.ts_ns);
    std::vector<Stay>& list = stays[step.cpu];
    const bool on = open[step.cpu] && list.back().tid == step.tid;
    switch (step.kind) {
      case XAUTO_BPF_EV_WAKEUP:
        woken_by[step.tid] = step.by;
        break;
      case XAUTO_BPF_EV_RUN:
        if (open[step.cpu]) list.back().end_ns = step.ts_ns;  // its end was lost
        list.push_back({step.ts_ns,
                        step.ts_ns,
                        step.delta_ns,
                        step.job,
                        step.tid,
                        step.xnode,
                        std::exchange(woken_by[step.tid], {}),
                        {}});
        open[step.cpu] = true;
        break;
      case XAUTO_BPF_EV_PREEMPT:
      case XAUTO_BPF_EV_SLEEP:
        if (!on) break;  // it began before the trace did
        list.back().end_ns = step.ts_ns;
        if (step.kind == XAUTO_BPF_EV_PREEMPT) list.back().preempted_by = step.by;
        open[step.cpu] = false;
        break;
      default:
        break;
    }
  }
  for (auto& [cpu, list] : stays)
    if (open[cpu]) list.back().end_ns = last;
  return stays;
}

}  // namespace

std::string cpu_trace(const std::string& title, const std::vector<CpuStep>& steps,
                      std::uint64_t lost, std::int64_t clock_offset_ns) {
  PerfettoWriter out(kSequence);
  const auto root =
      out.add_track(PerfettoWriter::kNoParent, title, "XNode threads on the kernel's CPUs");
  const std::int64_t begin = steps.empty() ? 0 : steps.front().ts_ns;
  if (lost > 0) {
    out.mark_lossy();
    out.instant(root, begin, fmt::format("INCOMPLETE: {} events were lost", lost),
                {"loss", {}, {}, {}});
  }
  for (auto& [cpu, list] : stays_of(steps)) {
    const auto track = out.add_track(root, fmt::format("kernel cpu{}", cpu));
    for (const Stay& stay : list) {
      PerfettoWriter::Details details{"cpu", {}, {}, {}};
      if (stay.job >= 0) details.args.emplace_back("release", stay.job);
      details.args.emplace_back("tid", std::int64_t{stay.tid});
      details.args.emplace_back("waited_us", stay.waited_ns / 1000);
      if (!stay.woken_by.empty()) details.args.emplace_back("woken_by", stay.woken_by);
      if (!stay.preempted_by.empty()) details.args.emplace_back("preempted_by", stay.preempted_by);
      out.begin(track, stay.begin_ns,
                stay.xnode == "-" ? fmt::format("thread {}", stay.tid) : stay.xnode,
                std::move(details));
      out.end(track, stay.end_ns);
    }
  }
  return out.write(clock_offset_ns);
}

}  // namespace xauto::story

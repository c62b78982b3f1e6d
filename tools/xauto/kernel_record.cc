// SPDX-License-Identifier: Apache-2.0
#include "xauto/kernel_record.h"

#include <algorithm>
#include <cstring>
#include <iterator>

#include <fmt/format.h>

#include "base/utf8.h"
#include "story/cpu_trace.h"
#include "story/perfetto.h"

namespace xauto::cli {
namespace {

constexpr std::size_t kMostEvents = 4'000'000;  ///< kept in memory, 56 bytes each

const char* kind_of(std::uint16_t kind) {
  constexpr const char* kNames[] = {"?", "wakeup", "run", "preempt", "sleep", "migrate"};
  return kind < std::size(kNames) ? kNames[kind] : "?";
}

/// Of a fixed field that the kernel has ended by 0: what any user has called a thread.
std::string text_of(const char (&field)[16]) {
  return for_terminal({field, strnlen(field, sizeof field)}, false);
}

Json event_json(const Live& live, const xauto_bpf_event& e) {
  Json j = {
      {"ts_ns", e.ts_ns},      {"kind", kind_of(e.kind)},       {"cpu", e.cpu},
      {"tid", e.tid},          {"xnode", live.xnode_of(e.job)}, {"job", e.job & XAUTO_BPF_JOB_SEQ},
      {"delta_ns", e.delta_ns}};
  if (e.kind == XAUTO_BPF_EV_WAKEUP || e.kind == XAUTO_BPF_EV_PREEMPT) {
    j["by_tid"] = e.arg;
    j["by"] = text_of(e.other);
  }
  return j;
}

std::string perfetto_of(const Live& live, const std::vector<xauto_bpf_event>& events,
                        std::uint64_t lost) {
  std::vector<story::CpuStep> steps;
  steps.reserve(events.size());
  for (const xauto_bpf_event& e : events) {
    const std::uint64_t number = e.job & XAUTO_BPF_JOB_SEQ;
    const bool none = e.job == 0 || number == XAUTO_BPF_JOB_EXPECTED;
    steps.push_back({static_cast<std::int64_t>(e.ts_ns), e.kind, e.cpu, e.tid, live.xnode_of(e.job),
                     none ? -1 : static_cast<std::int64_t>(number),
                     static_cast<std::int64_t>(e.delta_ns), text_of(e.other)});
  }
  std::stable_sort(
      steps.begin(), steps.end(),
      [](const story::CpuStep& a, const story::CpuStep& b) { return a.ts_ns < b.ts_ns; });
  return cpu_trace("kernel, run " + live.maps.run(), steps, lost, story::boottime_offset_ns());
}

}  // namespace

Result<std::size_t> KernelRecord::read(int timeout_ms) {
  return live_.tracer.read(timeout_ms, [this](const xauto_bpf_event& e) {
    if (events_.size() < kMostEvents)
      events_.push_back(e);
    else
      ++not_kept_;
  });
}

std::string KernelRecord::losses_line() const {
  const xauto_bpf_losses losses = live_.tracer.losses();
  if (losses.events + losses.pipe + losses.jobs + not_kept_ == 0)
    return fmt::format("complete: {} events, none lost", losses.written);
  std::string text = fmt::format("INCOMPLETE: of {} events {} were lost",
                                 losses.written + losses.events, losses.events + not_kept_);
  if (losses.jobs > 0) text += fmt::format("; {} short jobs are in no histogram", losses.jobs);
  if (losses.pipe > 0) text += fmt::format("; a reader of the pipe missed {}", losses.pipe);
  return text;
}

Json KernelRecord::json() const {
  const xauto_bpf_losses losses = live_.tracer.losses();
  return {{"events", events_.size() + not_kept_},
          {"lost",
           {{"events", losses.events + not_kept_}, {"jobs", losses.jobs}, {"pipe", losses.pipe}}}};
}

std::string KernelRecord::file(const std::string& path) const {
  const xauto_bpf_losses losses = live_.tracer.losses();
  const std::uint64_t lost = losses.events + not_kept_;
  if (path.ends_with(".pftrace")) return perfetto_of(live_, events_, lost);
  std::string text = Json{{"lost_events", lost}, {"lost_jobs", losses.jobs}}.dump() + "\n";
  for (const xauto_bpf_event& e : events_) text += event_json(live_, e).dump() + "\n";
  return text;
}

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
// xauto trace: what happens to the XNode threads of a run in the kernel. docs/tracing.md.
#include <algorithm>
#include <chrono>
#include <cstring>
#include <iostream>

#include <fmt/format.h>

#include "base/log.h"
#include "base/utf8.h"
#include "model/json_value.h"
#include "story/cpu_trace.h"
#include "story/perfetto.h"

#include "xauto/command.h"
#include "xauto/live.h"
#include "xauto/outputs.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

constexpr std::size_t kMostEvents = 4'000'000;  ///< kept in memory, 56 bytes each
constexpr int kPollMs = 100;

struct TraceFlags {
  std::string run, out;
  int duration_s = 0, wait_s = 10;
  std::uint32_t ring_kb = 1024;
  bool events = false, printk = false;
};

const char* kind_of(std::uint16_t kind) {
  constexpr const char* kNames[] = {"?", "wakeup", "run", "preempt", "sleep", "migrate"};
  return kind < std::size(kNames) ? kNames[kind] : "?";
}

/// Of a fixed field that the kernel has ended by 0: what any user has called a thread.
std::string text_of(const char (&field)[16]) {
  return for_terminal({field, strnlen(field, sizeof field)}, false);
}

std::string describe(const xauto_bpf_event& e) {
  const double us = static_cast<double>(e.delta_ns) * 1e-3;
  switch (e.kind) {
    case XAUTO_BPF_EV_WAKEUP:
      return fmt::format("by {} ({})", text_of(e.other), e.arg);
    case XAUTO_BPF_EV_RUN:
      return fmt::format("after {:.1f} us", us);
    case XAUTO_BPF_EV_PREEMPT:
      return fmt::format("after {:.1f} us, by {} ({})", us, text_of(e.other), e.arg);
    case XAUTO_BPF_EV_SLEEP:
      return fmt::format("after {:.1f} us", us);
    case XAUTO_BPF_EV_MIGRATE:
      return fmt::format("to CPU {}", e.cpu);
    default:
      return {};
  }
}

/// "17"; "-" before the thread's first job.
std::string number_of(std::uint64_t job) {
  const std::uint64_t number = job & XAUTO_BPF_JOB_SEQ;
  return job == 0 || number == XAUTO_BPF_JOB_EXPECTED ? "-" : std::to_string(number);
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

/// What --out gets: a Perfetto trace, or a JSON object per line.
std::string file_of(const TraceFlags& flags, const Live& live,
                    const std::vector<xauto_bpf_event>& events, std::uint64_t not_kept) {
  const xauto_bpf_losses losses = live.tracer.losses();
  const std::uint64_t lost = losses.events + not_kept;
  if (flags.out.ends_with(".pftrace")) return perfetto_of(live, events, lost);
  std::string text = Json{{"lost_events", lost}, {"lost_jobs", losses.jobs}}.dump() + "\n";
  for (const xauto_bpf_event& e : events) text += event_json(live, e).dump() + "\n";
  return text;
}

Result<int> trace(const TraceFlags& flags, const Options& options) {
  const StopOnSignal stop;
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  kernel::TracerOptions tracer_options;
  tracer_options.ring_bytes = flags.ring_kb * 1024;
  tracer_options.print = flags.printk;
  XAUTO_ASSIGN(Live live, observe(flags.run, flags.wait_s, tracer_options, *stop.flag()));
  log::info("tracing run {}; maps are pinned below {}", live.maps.run(),
            kernel::RunMaps::folder(live.maps.run()));

  // Of a run with tables: its counts outlive it.
  const auto watched = watch(live.maps.run(), 1, *stop.flag());

  std::vector<xauto_bpf_event> events;
  std::uint64_t not_kept = 0;
  const auto keep = [&](const xauto_bpf_event& e) {
    if (events.size() < kMostEvents)
      events.push_back(e);
    else
      ++not_kept;
  };
  const auto begin = std::chrono::steady_clock::now();
  while (!stop.flag()->load() && live.goes_on() &&
         (flags.duration_s == 0 ||
          std::chrono::steady_clock::now() - begin < std::chrono::seconds(flags.duration_s)))
    XAUTO_TRY(live.tracer.read(kPollMs, keep));
  for (;;) {
    XAUTO_ASSIGN(const std::size_t count, live.tracer.read(0, keep));
    if (count == 0) break;
  }
  const std::string first = losses_line(live.tracer.losses(), not_kept);

  const Counts counts = watched ? counts_of(*watched->board) : Counts();

  const std::vector<xauto_bpf_hist> hist = live.tracer.histograms();
  const xauto_bpf_hist zero{};
  if (options.json) {
    Json j;
    const xauto_bpf_losses losses = live.tracer.losses();
    j["complete"] = first.rfind("complete", 0) == 0;
    j["lost"] = {
        {"events", losses.events + not_kept}, {"jobs", losses.jobs}, {"pipe", losses.pipe}};
    if (counts.scenario) j["scenario"] = scenario_json(counts);
    j["events"] = events.size() + not_kept;  // more may have been written since the last look
    j["xnodes"] = Json::array();
    for (std::size_t i = 0; i < hist.size(); ++i) {
      const XNodeNumbers n = numbers_of(hist[i], zero);
      if (n.jobs + n.wakeups == 0) continue;
      j["xnodes"].push_back(
          {{"xnode", live.names[i].xnode},
           {"xpu", live.names[i].xpu},
           {"jobs", n.jobs},
           {"latency_us",
            {{"p50", measured(n.latency_p50_us)},
             {"p99", measured(n.latency_p99_us)},
             {"max", measured(n.latency_max_us)}}},
           {"run_us", {{"p50", measured(n.run_p50_us)}, {"p99", measured(n.run_p99_us)}}},
           {"wait_p99_us", measured(n.wait_p99_us)},
           {"preemptions", n.preemptions},
           {"migrations", n.migrations}});
    }
    std::cout << j.dump(2) << "\n";
    if (!flags.out.empty()) outputs.write(flags.out, file_of(flags, live, events, not_kept));
    return outputs.status(kDone);
  }
  std::cout << first << "\n";
  if (flags.events) {
    const std::uint64_t origin = events.empty() ? 0 : events.front().ts_ns;
    for (const xauto_bpf_event& e : events)
      std::cout << fmt::format("{:>12.3f} ms  cpu{:<3} {:<8} {:<16} job {:<6} tid {:<7} {}\n",
                               static_cast<double>(e.ts_ns - origin) * 1e-6, e.cpu, kind_of(e.kind),
                               live.xnode_of(e.job), number_of(e.job), e.tid, describe(e));
  }
  std::cout << fmt::format("\n  {:<18}{:<8}{:>7}{:>12}{:>9}{:>9}{:>11}{:>9}{:>10}{:>10}{:>7}\n",
                           "XNode", "XPU", "jobs", "latency p50", "p99", "max", "run p50", "p99",
                           "wait p99", "preempted", "moved");
  for (std::size_t i = 0; i < hist.size(); ++i) {
    const XNodeNumbers n = numbers_of(hist[i], zero);
    if (n.jobs + n.wakeups == 0) continue;
    std::cout << fmt::format(
        "  {:<18}{:<8}{:>7}{:>12}{:>9}{:>9}{:>11}{:>9}{:>10}{:>10}{:>7}\n", live.names[i].xnode,
        live.names[i].xpu, n.jobs, measured_text(n.latency_p50_us), measured_text(n.latency_p99_us),
        measured_text(n.latency_max_us), measured_text(n.run_p50_us), measured_text(n.run_p99_us),
        measured_text(n.wait_p99_us), n.preemptions, n.migrations);
  }
  std::cout
      << scenario_text(counts)
      << "\n  us; p50 and p99 are upper edges of powers of two; run and wait per job on a CPU\n";
  if (!flags.out.empty()) outputs.write(flags.out, file_of(flags, live, events, not_kept));
  return outputs.status(kDone);
}

}  // namespace

void add_trace(Commands& commands) {
  auto flags = std::make_shared<TraceFlags>();
  Verb verb = commands.add("trace", "Record what the kernel does with the XNode threads of a run.",
                           "xauto trace --duration-s 5 --events",
                           [flags](const Options& options) { return trace(*flags, options); });
  verb.option("--run", flags->run, "which run, if there are several");
  verb.option("--duration-s", flags->duration_s, "0: until the run ends, or Ctrl-C")
      .range(0, 86'400)
      .shown();
  verb.option("--wait-s", flags->wait_s, "how long to wait for a run to begin")
      .range(0, 86'400)
      .shown();
  verb.option("--ring-kb", flags->ring_kb, "buffer between kernel and us")
      .range(4u, 262'144u)
      .shown();
  verb.option(
      "--out", flags->out,
      "write the events here: FILE.pftrace for Perfetto's viewers, else a JSON object per line");
  verb.flag("--events", flags->events, "print each event");
  verb.flag("--printk", flags->printk, "also into the kernel's trace pipe (bpftool prog tracelog)");
}

}  // namespace xauto::cli

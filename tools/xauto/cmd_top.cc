// SPDX-License-Identifier: Apache-2.0
// xauto top: live numbers per XNode and per XPU of a run, in the terminal.
#include <chrono>
#include <ctime>
#include <iostream>
#include <map>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "base/clock.h"

#include "xauto/command.h"
#include "xauto/live.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

using nlohmann::ordered_json;

struct Flags {
  std::string run;
  int interval_ms = 1000, count = 0, wait_s = 10;
  bool list = false;
};

/// All that is looked at, at one moment.
struct Look {
  std::int64_t at_ns = 0;
  std::vector<xauto_bpf_hist> hist;
  std::vector<xauto_bpf_cpu> cpus;
  std::map<std::uint32_t, std::uint64_t> busy_ns;  ///< XPU -> time that jobs held it
};

Look look_at(const Live& live) {
  Look look{now_ns(), live.tracer.histograms(), live.tracer.cpus(), {}};
  for (std::uint32_t i = 0; i < live.maps.head().slots; ++i) {
    const volatile xauto_bpf_slot& slot = live.maps.slots()[i];
    if (slot.tid == 0) continue;
    const std::uint64_t held = slot.held_ns;
    const auto now = static_cast<std::uint64_t>(look.at_ns);
    const std::uint32_t xpu = slot.xpu;
    look.busy_ns[xpu] += slot.busy_ns + (held != 0 && now > held ? now - held : 0);
  }
  return look;
}

struct XpuLoad {
  std::string name, detail;
  double percent = 0;
};

std::vector<XpuLoad> loads_of(const Live& live, const Look& now, const Look& before) {
  const auto wall = static_cast<double>(now.at_ns - before.at_ns);
  std::map<std::uint32_t, XpuLoad> loads;
  const xauto_bpf_head& head = live.maps.head();
  for (std::size_t i = 0; i < live.names.size(); ++i) {
    if (live.names[i].xpu.empty()) continue;
    XpuLoad& load = loads[live.names[i].at];
    load.name = live.names[i].xpu;
    const std::uint32_t cpu =
        live.maps.table()[(live.maps.version() % XAUTO_BPF_BANKS) * head.xnodes + i].cpu;
    if (cpu < now.cpus.size() && wall > 0) {
      const auto share = [&](std::uint64_t a, std::uint64_t b) {
        return 100 * static_cast<double>(a - b) / wall;
      };
      load.percent = share(now.cpus[cpu].xnode_ns, before.cpus[cpu].xnode_ns);
      load.detail = fmt::format("CPU {}, others {:.0f} %", cpu,
                                share(now.cpus[cpu].other_ns, before.cpus[cpu].other_ns));
      continue;
    }
    const auto busy = [&](const Look& look) {
      const auto at = look.busy_ns.find(live.names[i].at);
      return at == look.busy_ns.end() ? 0.0 : static_cast<double>(at->second);
    };
    load.percent = std::max(0.0, 100 * (busy(now) - busy(before)) / wall);
    load.detail = "time that jobs hold it";
  }
  std::vector<XpuLoad> list;
  for (auto& [at, load] : loads) list.push_back(std::move(load));
  return list;
}

ordered_json as_json(const Live& live, const Look& now, const Look& before) {
  ordered_json j = {{"run", live.maps.run()},
                    {"interval_ms", (now.at_ns - before.at_ns) / 1'000'000},
                    {"lost_jobs", live.tracer.losses().jobs}};
  for (const XpuLoad& load : loads_of(live, now, before))
    j["xpus"].push_back({{"xpu", load.name}, {"load_pct", load.percent}});
  for (std::size_t i = 0; i < now.hist.size(); ++i) {
    const XNodeNumbers n = numbers_of(now.hist[i], before.hist[i]);
    j["xnodes"].push_back({{"xnode", live.names[i].xnode},
                           {"xpu", live.names[i].xpu},
                           {"jobs", n.jobs},
                           {"latency_p50_us", n.latency_p50_us},
                           {"latency_p99_us", n.latency_p99_us},
                           {"run_ms", n.run_ms},
                           {"wait_ms", n.wait_ms},
                           {"preemptions", n.preemptions}});
  }
  return j;
}

void draw(const Live& live, const Look& now, const Look& before, bool terminal) {
  std::string out = terminal ? "\x1b[H\x1b[2J" : "";
  const xauto_bpf_losses losses = live.tracer.losses();
  if (losses.jobs > 0)
    out += fmt::format("INCOMPLETE: {} short jobs are in no histogram\n", losses.jobs);
  out += fmt::format("run {}, {}\n\n", live.maps.run(),
                     live.maps.sched().running != 0 ? "sched_ext" : "no sched_ext");
  for (const XpuLoad& load : loads_of(live, now, before)) {
    const auto full = static_cast<std::size_t>(std::min(load.percent, 100.0) / 5 + 0.5);
    out += fmt::format("  {:<8}{:>6.1f} %  {:<20}  {}\n", load.name, load.percent,
                       std::string(full, '|'), load.detail);
  }
  out += fmt::format("\n  {:<18}{:<8}{:>7}{:>13}{:>8}{:>11}{:>11}{:>11}\n", "XNode", "XPU",
                     "jobs/s", "latency p50", "p99 us", "run ms/s", "wait ms/s", "preempted");
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  for (std::size_t i = 0; i < now.hist.size(); ++i) {
    const XNodeNumbers n = numbers_of(now.hist[i], before.hist[i]);
    out +=
        fmt::format("  {:<18}{:<8}{:>7.1f}{:>13}{:>8}{:>11.2f}{:>11.2f}{:>11}\n",
                    live.names[i].xnode, live.names[i].xpu, static_cast<double>(n.jobs) / s,
                    n.latency_p50_us, n.latency_p99_us, n.run_ms / s, n.wait_ms / s, n.preemptions);
  }
  std::cout << out << std::flush;
}

Result<int> top(const Flags& flags, const Options& options) {
  if (flags.list) {
    for (const std::string& run : kernel::RunMaps::runs()) std::cout << run << "\n";
    return kDone;
  }
  const StopOnSignal stop;
  kernel::TracerOptions tracer_options;
  tracer_options.events = false;
  tracer_options.pin = false;
  tracer_options.ring_bytes = 4096;
  XAUTO_ASSIGN(Live live, observe(flags.run, flags.wait_s, tracer_options, *stop.flag()));
  const bool terminal = isatty(STDOUT_FILENO) != 0;
  Look before = look_at(live);
  for (int shown = 0; flags.count == 0 || shown < flags.count; ++shown) {
    const auto until =
        std::chrono::steady_clock::now() + std::chrono::milliseconds(flags.interval_ms);
    while (std::chrono::steady_clock::now() < until && !stop.flag()->load() && live.goes_on())
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    if (stop.flag()->load() || !live.goes_on()) break;
    Look now = look_at(live);
    if (options.json)
      std::cout << as_json(live, now, before).dump() << std::endl;
    else
      draw(live, now, before, terminal);
    before = std::move(now);
  }
  return kDone;
}

}  // namespace

void add_top(Commands& commands) {
  auto flags = std::make_shared<Flags>();
  CLI::App* verb =
      commands.add("top", "Show a run live: latency, run and waiting time per XNode, load per XPU.",
                   "xauto top", [flags](const Options& options) { return top(*flags, options); });
  verb->add_option("--run", flags->run, "which run, if there are several");
  verb->add_option("--interval-ms", flags->interval_ms, "between two looks")
      ->check(CLI::Range(50, 60'000))
      ->capture_default_str();
  verb->add_option("--count", flags->count, "how many times; 0: until the run ends, or Ctrl-C")
      ->check(CLI::Range(0, 1'000'000))
      ->capture_default_str();
  verb->add_option("--wait-s", flags->wait_s, "how long to wait for a run to begin")
      ->check(CLI::Range(0, 86'400))
      ->capture_default_str();
  verb->add_flag("--list", flags->list, "only list the runs that can be observed");
}

}  // namespace xauto::cli

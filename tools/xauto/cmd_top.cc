// SPDX-License-Identifier: Apache-2.0
// xauto top: a run that goes on, in the terminal: what comes out per chain, what modules do, who
// runs and who waits per XPU. All from counts that the run keeps anyway. With root and BPF also
// what the kernel knows: load, and XNodes one by one.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <iostream>
#include <map>
#include <optional>
#include <thread>

#include <fmt/format.h>
#include <unistd.h>

#include "base/clock.h"
#include "model/json_value.h"

#include "xauto/command.h"
#include "xauto/counts.h"
#include "xauto/live.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct TopFlags {
  std::string run;
  int interval_ms = 1000, count = -1, wait_s = 10;
  bool list = false, once = false;
};

/// What BPF saw until one moment.
struct KernelLook {
  std::int64_t at_ns = 0;
  std::vector<xauto_bpf_hist> hist;
  std::vector<xauto_bpf_cpu> cpus;
  std::map<std::uint32_t, std::uint64_t> busy_ns;  ///< XPU -> time that jobs held it
};

KernelLook look_at(const Live& live) {
  KernelLook look{now_ns(), live.tracer.histograms(), live.tracer.cpus(), {}};
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

std::vector<XpuLoad> loads_of(const Live& live, const KernelLook& now, const KernelLook& before) {
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
    const auto busy = [&](const KernelLook& look) {
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

/// Who is on an XPU, and who would like to be.
struct XpuState {
  std::string xpu;
  std::vector<std::string> running, waiting;  ///< waiting: or suspended
};

std::vector<XpuState> states_of(const std::string& run) {
  std::vector<XpuState> states;
  const auto asked = ask_coordinators(run);
  const auto found = asked.find(run);
  if (found == asked.end()) return states;
  for (const XpuStatus& answer : found->second.xpus) {
    XpuState state{answer.xpu, {}, {}};
    for (const WorkerStatus& worker : answer.workers) {
      if (worker.idle() || worker.state == "starting") continue;
      (worker.state == "running" ? state.running : state.waiting).push_back(worker.xnode);
    }
    states.push_back(std::move(state));
  }
  return states;
}

/// All that is looked at, at one moment.
struct Look {
  Counts counts;
  std::vector<XpuState> xpus;
  std::optional<KernelLook> kernel;  ///< none: `why_not` of the run's observer
};

struct Observed {
  Watched run;
  std::optional<Live> live;
  std::string why_not;  ///< there is no `live`

  [[nodiscard]] bool goes_on() const {
    const std::vector<std::string> runs = running();
    return std::find(runs.begin(), runs.end(), run.run) != runs.end();
  }
  [[nodiscard]] Look look() const {
    Look look{counts_of(*run.board), states_of(run.run), {}};
    if (live) look.kernel = look_at(*live);
    return look;
  }
};

/// Chains over the time between two looks, and over the whole run what is claimed of them.
Json chains_json(const Counts& now, const Counts& before) {
  Json chains = Json::array();
  for (std::size_t i = 0; i < now.chains.size(); ++i) {
    const FlowCounts& chain = now.chains[i];
    const FlowNumbers n = numbers_of(chain, before.chains[i], now.at_ns, before.at_ns);
    Json shown = {{"name", chain.name},
                  {"rate_hz", n.rate_hz},
                  {"p50_us", measured(n.p50_us)},
                  {"p99_us", measured(n.p99_us)},
                  {"max_us", measured(n.max_us)},
                  {"age_us", chain.gone ? Json() : measured(n.age_us)},
                  {"off", chain.gone},
                  {"results", chain.results()},
                  {"lost", chain.lost},
                  {"deadline_misses", chain.deadline_misses},
                  {"age_misses", chain.age_misses},
                  {"last_us", measured(chain.last_us)},
                  {"longest_us", measured(chain.longest_us)}};
    if (chain.worst_case_us > 0) shown["worst_case_us"] = chain.worst_case_us;
    if (chain.lower_bound_us > 0) shown["lower_bound_us"] = chain.lower_bound_us;
    if (chain.urgent_worst_case_us > 0)
      shown["urgent"] = {{"longest_us", measured(chain.longest_urgent_us)},
                         {"worst_case_us", chain.urgent_worst_case_us}};
    chains.push_back(std::move(shown));
  }
  return chains;
}

Json modules_json(const Counts& now, const Counts& before) {
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  Json modules = Json::array();
  for (std::size_t m = 0; m < now.modules.size(); ++m) {
    const ModuleCounts& module = now.modules[m];
    modules.push_back(
        {{"name", module.name},
         {"rate_hz", static_cast<double>(module.activations - before.modules[m].activations) / s},
         {"activations", module.activations},
         {"dropped", module.dropped},
         {"failed", module.failed},
         {"off", module.off},
         {"skipped", module.skipped},
         {"deaths", module.deaths}});
  }
  return modules;
}

/// What the kernel knows: load, and XNodes one by one.
void add_kernel(const Live& live, const KernelLook& now, const KernelLook& before, Json& into) {
  into["kernel"] = "ok";
  into["lost_jobs"] = live.tracer.losses().jobs;
  for (const XpuLoad& load : loads_of(live, now, before)) {
    std::vector<Json>& xpus = into["xpus"].elements();
    const auto at = std::find_if(xpus.begin(), xpus.end(),
                                 [&](const Json& x) { return x.at("xpu").text() == load.name; });
    if (at != xpus.end())
      (*at)["load_pct"] = load.percent;
    else
      xpus.push_back({{"xpu", load.name}, {"load_pct", load.percent}});
  }
  for (std::size_t i = 0; i < now.hist.size(); ++i) {
    if (live.names[i].xnode.empty()) continue;  // room for apps that join the run
    const XNodeNumbers n = numbers_of(now.hist[i], before.hist[i]);
    into["xnodes"].push_back({{"xnode", live.names[i].xnode},
                              {"xpu", live.names[i].xpu},
                              {"jobs", n.jobs},
                              {"latency_p50_us", measured(n.latency_p50_us)},
                              {"latency_p99_us", measured(n.latency_p99_us)},
                              {"run_ms", n.run_ms},
                              {"wait_ms", n.wait_ms},
                              {"preemptions", n.preemptions}});
  }
}

Json as_json(const Observed& observed, const Look& now, const Look& before) {
  const Counts& counts = now.counts;
  Json j = {{"run", observed.run.run},
            {"app", observed.run.app},
            {"platform", observed.run.platform},
            {"scheduling", observed.run.scheduling},
            {"interval_ms", (counts.at_ns - before.counts.at_ns) / 1'000'000},
            {"releases", counts.released},
            {"chains", chains_json(counts, before.counts)},
            {"claims", runtime::claims_json(counts.account)}};
  if (counts.scenario) j["scenario"] = scenario_json(counts);
  j["modules"] = modules_json(counts, before.counts);
  j["xpus"] = Json::array();
  for (const XpuState& state : now.xpus)
    j["xpus"].push_back(
        {{"xpu", state.xpu}, {"running", state.running}, {"waiting", state.waiting}});
  if (now.kernel && before.kernel)
    add_kernel(*observed.live, *now.kernel, *before.kernel, j);
  else
    j["kernel"] = observed.why_not;
  return j;
}

std::string list_of(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text.empty() ? "-" : text;
}

/// Loads and XNodes, as BPF saw them. `tables`: each of them has all XNodes; shown are those with jobs.
std::string kernel_part(const Live& live, const KernelLook& now, const KernelLook& before,
                        bool tables) {
  std::string out;
  const xauto_bpf_losses losses = live.tracer.losses();
  if (losses.jobs > 0)
    out += fmt::format("\nINCOMPLETE: {} short jobs are in no histogram\n", losses.jobs);
  out += fmt::format("\n  {}\n", live.maps.sched().running != 0 ? "sched_ext" : "no sched_ext");
  for (const XpuLoad& load : loads_of(live, now, before)) {
    const auto full = static_cast<std::size_t>(std::lround(std::min(load.percent, 100.0) / 5));
    out += fmt::format("  {:<8}{:>6.1f} %  {:<20}  {}\n", load.name, load.percent,
                       std::string(full, '|'), load.detail);
  }
  out += fmt::format("\n  {:<18}{:<8}{:>7}{:>13}{:>8}{:>11}{:>11}{:>11}\n", "XNode", "XPU",
                     "jobs/s", "latency p50", "p99 us", "run ms/s", "wait ms/s", "preempted");
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  for (std::size_t i = 0; i < now.hist.size(); ++i) {
    if (live.names[i].xnode.empty()) continue;  // room for apps that join the run
    const XNodeNumbers n = numbers_of(now.hist[i], before.hist[i]);
    if (tables && n.jobs == 0) continue;
    out += fmt::format("  {:<18}{:<8}{:>7.1f}{:>13}{:>8}{:>11.2f}{:>11.2f}{:>11}\n",
                       live.names[i].xnode, live.names[i].xpu, static_cast<double>(n.jobs) / s,
                       measured_text(n.latency_p50_us), measured_text(n.latency_p99_us),
                       n.run_ms / s, n.wait_ms / s, n.preemptions);
  }
  return out;
}

void draw(const Observed& observed, const Look& now, const Look& before, bool terminal) {
  const Counts &c = now.counts, &b = before.counts;
  const double s = static_cast<double>(c.at_ns - b.at_ns) * 1e-9;
  const auto ms = [](std::int64_t us) {
    return us < 0 ? std::string("-") : fmt::format("{:.2f}", static_cast<double>(us) / 1000);
  };
  std::string out = terminal ? "\x1b[H\x1b[2J" : "";
  out += fmt::format("run {}: {} on {}, {}; {} releases, numbers of the last {:.1f} s\n\n",
                     observed.run.run, observed.run.app, observed.run.platform,
                     observed.run.scheduling, c.released, s);
  out += fmt::format("  {:<28}{:>9}{:>9}{:>9}{:>9}{:>9}{:>8}{:>8}{:>6}\n", "chain, ms", "per s",
                     "p50", "p99", "max", "age", "lost", "missed", "old");
  for (std::size_t i = 0; i < c.chains.size(); ++i) {
    const FlowCounts& chain = c.chains[i];
    const FlowNumbers n = numbers_of(chain, b.chains[i], c.at_ns, b.at_ns);
    out +=
        fmt::format("  {:<28}{:>9.1f}{:>9}{:>9}{:>9}{:>9}{:>8}{:>8}{:>6}\n", chain.name, n.rate_hz,
                    ms(n.p50_us), ms(n.p99_us), ms(n.max_us), chain.gone ? "off" : ms(n.age_us),
                    chain.lost, chain.deadline_misses, chain.age_misses);
  }
  out += claims_text(c);
  out += scenario_text(c);
  out += fmt::format("\n  {:<28}{:>9}{:>13}{:>9}{:>9}\n", "module", "per s", "activations",
                     "dropped", "failed");
  for (std::size_t m = 0; m < c.modules.size(); ++m) {
    const ModuleCounts& module = c.modules[m];
    out += fmt::format("  {:<28}{:>9.1f}{:>13}{:>9}{:>9}{}{}\n", module.name,
                       static_cast<double>(module.activations - b.modules[m].activations) / s,
                       module.activations, module.dropped, module.failed,
                       module.off == 0 ? "" : fmt::format("  off: {}", module.off),
                       module.deaths == 0 ? "" : fmt::format("  died: {}", module.deaths));
  }
  out += fmt::format("\n  {:<8}{:<28}{}\n", "XPU", "runs now", "waits or is suspended");
  for (const XpuState& state : now.xpus)
    out +=
        fmt::format("  {:<8}{:<28}{}\n", state.xpu, list_of(state.running), list_of(state.waiting));
  if (now.xpus.empty()) out += "  nobody schedules this run: XPUs are not watched\n";
  if (now.kernel && before.kernel)
    out += kernel_part(*observed.live, *now.kernel, *before.kernel, !c.scenarios.empty());
  else
    out += fmt::format("\n  load and XNodes one by one need BPF: {}\n", observed.why_not);
  std::cout << out << std::flush;
}

Result<int> top(const TopFlags& flags, const Options& options) {
  if (flags.list) {
    const std::vector<std::string> runs = ours();
    if (options.json)
      std::cout << Json{{"runs", runs}}.dump() << "\n";
    else
      for (const std::string& run : runs) std::cout << run << "\n";
    return kDone;
  }
  const StopOnSignal stop;
  const bool terminal = can_draw(STDOUT_FILENO);
  // A script gets one look, and does not wait for the run's end.
  const int count = flags.once ? 1 : flags.count >= 0 ? flags.count : terminal ? 0 : 1;
  Observed observed;
  XAUTO_ASSIGN(observed.run, watch(flags.run, flags.wait_s, *stop.flag()));
  kernel::TracerOptions tracer_options;
  tracer_options.events = false;
  tracer_options.pin = false;
  tracer_options.ring_bytes = 4096;
  if (auto live = observe(observed.run.run, 0, tracer_options, *stop.flag()))
    observed.live.emplace(std::move(*live));
  else
    observed.why_not = live.error().what;
  Look before = observed.look();
  for (int shown = 0; count == 0 || shown < count; ++shown) {
    const auto until =
        std::chrono::steady_clock::now() + std::chrono::milliseconds(flags.interval_ms);
    while (std::chrono::steady_clock::now() < until && !stop.flag()->load() && observed.goes_on())
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const bool over = stop.flag()->load() || !observed.goes_on();
    if (over && shown > 0) break;  // the first is shown in any case: its counts are there
    Look now = observed.look();
    if (options.json)
      std::cout << as_json(observed, now, before).dump() << std::endl;
    else
      draw(observed, now, before, terminal && count != 1);
    if (over || !std::cout) break;
    before = std::move(now);
  }
  return kDone;
}

}  // namespace

void add_top(Commands& commands) {
  auto flags = std::make_shared<TopFlags>();
  Verb verb =
      commands.add("top",
                   "Show a run live: rate, latency, age and losses per chain and module, who runs "
                   "and who waits per XPU.",
                   "xauto top", [flags](const Options& options) { return top(*flags, options); });
  verb.option("--run", flags->run, "which run, if there are several");
  verb.option("--interval-ms", flags->interval_ms, "between two looks").range(50, 60'000).shown();
  verb.option("--count", flags->count,
              "how many times; 0: until the run ends, or Ctrl-C; default: 0 on a "
              "terminal, else 1")
      .range(0, 1'000'000);
  verb.flag("--once", flags->once, "one look, without clearing the terminal").excludes("--count");
  verb.option("--wait-s", flags->wait_s, "how long to wait for a run to begin")
      .range(0, 86'400)
      .shown();
  verb.flag("--list", flags->list, "only list the runs that can be observed");
}

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
#include "xauto/shown_run.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/columns.h"

#include "xauto/asking.h"

namespace xauto::cli {
namespace {

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

double seconds_of(const ShownRun& shown) {
  return static_cast<double>(shown.now.counts.at_ns - shown.before.counts.at_ns) * 1e-9;
}

/// Chains over the time between two looks, and over the whole run what is claimed of them.
Json chains_json(const Counts& now, const Counts& before) {
  Json chains = Json::array();
  for (std::size_t i = 0; i < now.chains.size(); ++i) {
    const FlowCounts& chain = now.chains[i];
    const FlowNumbers n =
        numbers_of(chain, same(before.chains, i, chain.name), now.at_ns, before.at_ns);
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

Json elsewhere_json(const Counts& now) {
  Json chains = Json::array();
  for (const ChainElsewhere& chain : now.elsewhere)
    chains.push_back({{"name", chain.name}, {"host", chain.host}});
  return chains;
}

Json crossings_json(const Counts& now) {
  Json crossings = Json::array();
  for (const CrossingCounts& of : now.crossings)
    crossings.push_back({{"xnode", of.xnode},
                         {"from", of.from},
                         {"to", of.to},
                         {"x_us", of.x_us},
                         {"longest_us", of.messages > 0 ? Json(of.longest_us) : Json()},
                         {"messages", of.messages},
                         {"lost", of.lost},
                         {"late", of.late}});
  return crossings;
}

double rate_of(const ModuleCounts& module, const Counts& before, std::size_t index, double s) {
  const std::uint64_t then = same(before.modules, index, module.name).activations;
  return static_cast<double>(module.activations - then) / s;
}

Json modules_json(const Counts& now, const Counts& before) {
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  Json modules = Json::array();
  for (std::size_t m = 0; m < now.modules.size(); ++m) {
    const ModuleCounts& module = now.modules[m];
    modules.push_back({{"name", module.name},
                       {"rate_hz", rate_of(module, before, m, s)},
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
                              {"latency_max_us", measured(n.latency_max_us)},
                              {"run_p50_us", measured(n.run_p50_us)},
                              {"run_p99_us", measured(n.run_p99_us)},
                              {"wait_p99_us", measured(n.wait_p99_us)},
                              {"run_us", std::llround(n.run_ms * 1e3)},
                              {"wait_us", std::llround(n.wait_ms * 1e3)},
                              {"preemptions", n.preemptions},
                              {"migrations", n.migrations}});
  }
}

std::string chains_text(const Counts& now, const Counts& before) {
  std::string out = row_of("chain, ms", kNameColumns) +
                    fmt::format("{:>6}{:>7}{:>7}{:>7}{:>7}{:>6}{:>7}{:>4}\n", "per s", "p50", "p99",
                                "max", "age", "lost", "missed", "old");
  for (std::size_t i = 0; i < now.chains.size(); ++i) {
    const FlowCounts& chain = now.chains[i];
    const FlowNumbers n =
        numbers_of(chain, same(before.chains, i, chain.name), now.at_ns, before.at_ns);
    out += row_of(chain.name, kNameColumns) +
           fmt::format("{:>6.1f}{:>7}{:>7}{:>7}{:>7}{:>6}{:>7}{:>4}\n", n.rate_hz,
                       ms_in_row(n.p50_us), ms_in_row(n.p99_us), ms_in_row(n.max_us),
                       chain.gone ? "off" : ms_in_row(n.age_us), chain.lost, chain.deadline_misses,
                       chain.age_misses);
  }
  for (const ChainElsewhere& chain : now.elsewhere)
    out += row_of(chain.name, kNameColumns) + "ends on host " + chain.host + "\n";
  return out;
}

/// What comes from other hosts, each beside its X.
std::string crossings_text(const Counts& now) {
  if (now.crossings.empty()) return {};
  std::string out =
      "\n" + row_of("from other hosts, ms", kNameColumns) +
      fmt::format("{:>9}{:>9}{:>9}{:>7}{:>6}\n", "longest", "X", "messages", "lost", "late");
  for (const CrossingCounts& of : now.crossings)
    out +=
        row_of(of.xnode + " from " + of.from, kNameColumns) +
        fmt::format("{:>9}{:>9}{:>9}{:>7}{:>6}\n", ms_in_row(of.messages > 0 ? of.longest_us : -1),
                    ms_in_row(of.x_us), of.messages, of.lost, of.late);
  return out;
}

std::string modules_text(const Counts& now, const Counts& before) {
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  std::string out =
      "\n" + row_of("module", kNameColumns) +
      fmt::format("{:>6}{:>13}{:>9}{:>8}\n", "per s", "activations", "dropped", "failed");
  for (std::size_t m = 0; m < now.modules.size(); ++m) {
    const ModuleCounts& module = now.modules[m];
    out += row_of(module.name, kNameColumns) +
           fmt::format("{:>6.1f}{:>13}{:>9}{:>8}{}{}\n", rate_of(module, before, m, s),
                       module.activations, module.dropped, module.failed,
                       module.off == 0 ? "" : fmt::format("  off: {}", module.off),
                       module.deaths == 0 ? "" : fmt::format("  died: {}", module.deaths));
  }
  return out;
}

std::string list_of(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text.empty() ? "-" : text;
}

/// Who is on an XPU, and who would like to be.
std::string xpus_text(const std::vector<XpuStatus>& xpus) {
  if (xpus.empty()) return "  nobody schedules this run: XPUs are not watched\n";
  std::string out = "\n  " + left("XPU", 10) + left("runs now", 26) + "waits or is suspended\n";
  for (const XpuStatus& xpu : xpus) {
    std::vector<std::string> running, waiting;
    for (const WorkerStatus& worker : xpu.workers) {
      if (worker.idle() || worker.state == "starting") continue;
      (worker.state == "running" ? running : waiting).push_back(worker.xnode);
    }
    out += "  " + left(xpu.xpu, 10) + left(list_of(running), 26) + cut(list_of(waiting), 42) + "\n";
  }
  return out;
}

std::string doing(const WorkerStatus& worker) {
  if (worker.idle()) return worker.state;
  const auto ms = [](std::int64_t us) { return static_cast<double>(us) / 1000; };
  const std::string urgency = worker.due_us ? fmt::format("due in {:.2f} ms", ms(*worker.due_us))
                                            : fmt::format("priority {}", worker.priority);
  return fmt::format("{}: {} (job {}, {}, since {:.2f} ms){}", worker.state, worker.xnode,
                     worker.job, urgency, ms(static_cast<std::int64_t>(worker.since_us)),
                     worker.by.empty() ? "" : " by " + worker.by);
}

std::string workers_text(const std::vector<XpuStatus>& xpus) {
  constexpr std::size_t kWorkerColumns = 20;
  std::string out = "\n";
  for (const XpuStatus& xpu : xpus) {
    out += "  " + left(xpu.xpu, 10) +
           fmt::format("{}, {}; coordinator pid {}, {} decisions\n", to_string(xpu.discipline),
                       xpu.arbitrated ? "arbitrated" : "uncontended", xpu.pid, xpu.decisions);
    for (const WorkerStatus& worker : xpu.workers)
      out += wrapped("    " + left(worker.worker, kWorkerColumns) + doing(worker),
                     4 + kWorkerColumns) +
             "\n";
  }
  return out;
}

/// Loads and XNodes, as BPF saw them. `tables`: each of them has all XNodes; shown are those with jobs.
std::string kernel_text(const Live& live, const KernelRecord* record, const KernelLook& now,
                        const KernelLook& before, bool tables) {
  std::string out;
  const xauto_bpf_losses losses = live.tracer.losses();
  if (record != nullptr)
    out += "\n" + record->losses_line() + "\n";
  else if (losses.jobs > 0)
    out += fmt::format("\nINCOMPLETE: {} short jobs are in no histogram\n", losses.jobs);
  out += fmt::format("\n  {}\n", live.maps.sched().running != 0 ? "sched_ext" : "no sched_ext");
  for (const XpuLoad& load : loads_of(live, now, before)) {
    const auto full = static_cast<std::size_t>(std::lround(std::min(load.percent, 100.0) / 5));
    out +=
        "  " + left(load.name, 10) +
        fmt::format("{:>6.1f} %  {:<20}  {}\n", load.percent, std::string(full, '|'), load.detail);
  }
  out += "\n  " + left("XNode, latency in us", 22) + left("XPU", 8) +
         fmt::format("{:>7}{:>7}{:>7}{:>9}{:>10}{:>8}\n", "jobs/s", "p50", "p99", "run ms/s",
                     "wait ms/s", "preempt");
  const double s = static_cast<double>(now.at_ns - before.at_ns) * 1e-9;
  for (std::size_t i = 0; i < now.hist.size(); ++i) {
    if (live.names[i].xnode.empty()) continue;  // room for apps that join the run
    const XNodeNumbers n = numbers_of(now.hist[i], before.hist[i]);
    if (tables && n.jobs == 0) continue;
    out += row_of(live.names[i].xnode, 22) + left(live.names[i].xpu, 8) +
           fmt::format("{:>7.1f}{:>7}{:>7}{:>9.2f}{:>10.2f}{:>8}\n",
                       static_cast<double>(n.jobs) / s, measured_text(n.latency_p50_us),
                       measured_text(n.latency_p99_us), n.run_ms / s, n.wait_ms / s, n.preemptions);
  }
  return out;
}

}  // namespace

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

Json json_of(const ShownRun& shown) {
  Json j = {{"run", shown.run}, {"user", user_name(shown.uid)}};
  if (shown.watched) {
    const Counts &now = shown.now.counts, &before = shown.before.counts;
    j["app"] = shown.watched->app;
    j["platform"] = shown.watched->platform;
    j["scheduling"] = shown.watched->scheduling;
    j["interval_us"] = (now.at_ns - before.at_ns) / 1'000;
    j["releases"] = now.released;
    j["chains"] = chains_json(now, before);
    j["claims"] = runtime::claims_json(now.account);
    if (now.scenario) j["scenario"] = scenario_json(now);
    j["modules"] = modules_json(now, before);
    if (!shown.watched->host.empty()) {
      j["host"] = shown.watched->host;
      j["chains_elsewhere"] = elsewhere_json(now);
      j["crossings"] = crossings_json(now);
    }
  }
  j["xpus"] = Json::array();
  for (const XpuStatus& xpu : shown.now.xpus) j["xpus"].push_back(to_json(xpu));
  if (shown.live != nullptr && shown.now.kernel && shown.before.kernel)
    add_kernel(*shown.live, *shown.now.kernel, *shown.before.kernel, j);
  else
    j["kernel"] = shown.why_not;
  if (shown.record != nullptr) j["record"] = shown.record->json();
  return j;
}

std::string text_of(const ShownRun& shown, bool workers) {
  std::string out = "run " + shown.run + (shown.uid == geteuid() ? "" : " of ") +
                    (shown.uid == geteuid() ? "" : user_name(shown.uid));
  if (!shown.watched) return out + "\n" + workers_text(shown.now.xpus);
  const Counts &now = shown.now.counts, &before = shown.before.counts;
  const std::string& host = shown.watched->host;
  out +=
      fmt::format(": {} on {}{}, {}; {} releases, numbers of the last {:.1f} s", shown.watched->app,
                  shown.watched->platform, host.empty() ? "" : ", the part of host " + host,
                  shown.watched->scheduling, now.released, seconds_of(shown));
  out = wrapped(out, 2) + "\n\n" + chains_text(now, before);
  out += claims_text(now) + scenario_text(now) + crossings_text(now) + modules_text(now, before);
  out +=
      workers && !shown.now.xpus.empty() ? workers_text(shown.now.xpus) : xpus_text(shown.now.xpus);
  if (shown.live != nullptr && shown.now.kernel && shown.before.kernel)
    out += kernel_text(*shown.live, shown.record, *shown.now.kernel, *shown.before.kernel,
                       !now.scenarios.empty());
  else
    out += "\n" + wrapped("  load and XNodes one by one need BPF: " + shown.why_not, 2) + "\n";
  return out;
}

}  // namespace xauto::cli

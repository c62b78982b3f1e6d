// SPDX-License-Identifier: Apache-2.0
#include "xauto/report.h"

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "xauto/gate.h"
#include "xauto/perfetto.h"
#include "xauto/run_trace.h"

namespace xauto::cli {
namespace {

using nlohmann::ordered_json;

std::uint64_t lost_releases(const PolicyRun& run) {
  return run.report.lost_releases;
}

ordered_json quantiles_json(const runtime::Distribution& us) {
  const Latency l = summarise(us);
  return {{"p50", l.p50_us}, {"p99", l.p99_us}, {"max", l.max_us}};
}

/// Chains and XNodes with limits.
std::string limits_table(const PolicyRun& run) {
  std::string out;
  const auto ms = [](std::int64_t us) {
    return fmt::format("{:.2f}", static_cast<double>(us) / 1000);
  };
  if (!run.report.routes.empty()) {
    out += fmt::format("\n  {:<28}{:>9}{:>9}{:>9}{:>10}{:>10}{:>9}{:>8}{:>7}\n", "chain", "p50",
                       "p99", "max", "deadline", "age max", "missed", "old", "n");
    for (const runtime::RouteReport& r : run.report.routes) {
      const Latency l = summarise(r.latency_us);
      out +=
          fmt::format("  {:<28}{:>9}{:>9}{:>9}{:>10}{:>10}{:>9}{:>8}{:>7}\n", r.name, ms(l.p50_us),
                      ms(l.p99_us), ms(l.max_us), r.deadline_us ? ms(*r.deadline_us) : "",
                      ms(r.age_us.max()), r.deadline_us ? std::to_string(r.deadline_misses) : "",
                      r.max_age_us ? std::to_string(r.age_misses) : "", l.count);
    }
  }
  for (const runtime::XNodeReport& x : run.report.xnodes)
    if (x.overruns > 0 || x.hangs > 0)
      out +=
          fmt::format("  XNode {}: of {} jobs {} exceeded {} ms, {} hung; the longest took {} ms\n",
                      x.name, x.jobs, x.overruns, ms(x.budget_us), x.hangs, ms(x.longest_us));
  return out;
}

const PolicyRun* ros2_of(const std::vector<PolicyRun>& runs) {
  const auto at = std::find_if(runs.begin(), runs.end(), [](const PolicyRun& r) {
    return r.scheduling == runtime::Scheduling::kRos2;
  });
  return at == runs.end() ? nullptr : &*at;
}

double ratio(std::int64_t a, std::int64_t b) {
  return b == 0 ? 0.0 : static_cast<double>(a) / static_cast<double>(b);
}

double coordinators_cpu_pct(const PolicyRun& run) {
  return run.outcome.wall_s <= 0
             ? 0.0
             : static_cast<double>(run.outcome.coordinators_cpu_us) / (run.outcome.wall_s * 1e4);
}

/// From the first event that is there to the last.
double traced_s(const trace::Recording& trace) {
  if (trace.events.empty()) return 0;
  return static_cast<double>(trace.events.back().ts_ns - trace.events.front().ts_ns) * 1e-9;
}

}  // namespace

bool healthy(const PolicyRun& run) {
  return run.report.complete && lost_releases(run) == 0 && run.report.lost_coordinators.empty() &&
         !run.outcome.emulator_died;
}

std::string report_json(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  ordered_json list = ordered_json::array();
  const PolicyRun* base = ros2_of(runs);
  for (const PolicyRun& run : runs) {
    ordered_json j = {{"policy", run.id},
                      {"p50_us", run.latency.p50_us},
                      {"p99_us", run.latency.p99_us},
                      {"max_us", run.latency.max_us},
                      {"predicted_us", run.predicted.makespan},
                      {"mean_us", run.latency.mean_us},
                      {"activations", run.latency.count},
                      {"lost_activations", lost_releases(run)},
                      {"complete", run.report.complete},
                      {"deadline_misses", run.report.deadline_misses},
                      {"scheduling", runtime::to_string(run.scheduling)},
                      {"trace_events_lost", run.outcome.trace.lost},
                      {"trace_events_overwritten", run.outcome.trace.overwritten},
                      {"trace_s", traced_s(run.outcome.trace)},
                      {"coordinators_cpu_pct", coordinators_cpu_pct(run)}};
    if (!flags.fail_on.empty()) {
      ordered_json gate = ordered_json::object();
      for (const GateCount& g : gate_of(flags, run)) gate[g.word] = g.count;
      j["fail_on"] = std::move(gate);
    }
    if (base != nullptr)
      j["p99_speedup_over_ros2"] = ratio(base->latency.p99_us, run.latency.p99_us);
    if (run.policy) {
      j["optimal"] = run.policy->optimal;
      j["lower_bound_us"] = run.policy->lower_bound_us;
      if (run.policy->worst_case_us) j["worst_case_us"] = *run.policy->worst_case_us;
      ordered_json placement = ordered_json::object();
      for (std::size_t i = 0; i < flags.app.xnodes.size(); ++i)
        placement[flags.app.xnodes[i].name] =
            flags.spec.xpus[static_cast<std::size_t>(run.policy->placements[i].xpu)].id;
      j["placement"] = std::move(placement);
    }
    ordered_json modules = ordered_json::array();
    for (const runtime::ModuleReport& m : run.report.modules) {
      ordered_json entry = {{"name", m.name},
                            {"activations", m.activations},
                            {"failed", m.failed},
                            {"dropped", m.dropped}};
      if (m.sink) {
        const Latency latency = summarise(m.latencies_us);
        entry["p50_us"] = latency.p50_us;
        entry["p99_us"] = latency.p99_us;
        entry["max_us"] = latency.max_us;
      }
      modules.push_back(std::move(entry));
    }
    j["modules"] = std::move(modules);
    ordered_json chains = ordered_json::array();
    for (const runtime::RouteReport& r : run.report.routes) {
      ordered_json chain = {{"name", r.name},
                            {"from", r.from},
                            {"to", r.to},
                            {"results", r.latency_us.count()},
                            {"lost", r.lost},
                            {"latency_us", quantiles_json(r.latency_us)},
                            {"age_us", quantiles_json(r.age_us)}};
      if (r.deadline_us) {
        chain["deadline_us"] = *r.deadline_us;
        chain["deadline_misses"] = r.deadline_misses;
      }
      if (r.max_age_us) {
        chain["max_age_us"] = *r.max_age_us;
        chain["age_misses"] = r.age_misses;
      }
      chains.push_back(std::move(chain));
    }
    j["chains"] = std::move(chains);
    ordered_json xnodes = ordered_json::array();
    for (const runtime::XNodeReport& x : run.report.xnodes) {
      ordered_json entry = {{"name", x.name}, {"jobs", x.jobs}, {"longest_us", x.longest_us}};
      if (x.budget_us > 0) {
        entry["budget_us"] = x.budget_us;
        entry["overruns"] = x.overruns;
      }
      if (x.hang_us > 0) {
        entry["hang_us"] = x.hang_us;
        entry["hangs"] = x.hangs;
      }
      xnodes.push_back(std::move(entry));
    }
    j["limited_xnodes"] = std::move(xnodes);
    ordered_json notes = ordered_json::array();
    if (!run.report.note.empty()) notes.push_back(run.report.note);
    for (const std::string& note : run.outcome.notes) notes.push_back(note);
    j["notes"] = std::move(notes);
    list.push_back(std::move(j));
  }
  return ordered_json{{"schema", "xauto.report"},   {"version", 1},
                      {"app", flags.app.name},      {"platform", flags.spec.name},
                      {"emulated", flags.emulated}, {"runs", std::move(list)}}
             .dump(2) +
         "\n";
}

std::string report_table(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  const PolicyRun* base = ros2_of(runs);
  std::string out = fmt::format("{} on {}{}, end-to-end latency in ms\n\n", flags.app.name,
                                flags.spec.name, flags.emulated ? " (emulated)" : "");
  out += fmt::format("  {:<28}{:>9}{:>9}{:>9}{:>11}{:>9}{:>7}{:>6}\n", "policy", "p50", "p99",
                     "max", "simulated", "p50/sim", "p99 x", "n");
  for (const PolicyRun& run : runs) {
    const auto ms = [](std::int64_t us) {
      return fmt::format("{:.2f}", static_cast<double>(us) / 1000);
    };
    out += fmt::format(
        "  {:<28}{:>9}{:>9}{:>9}{:>11}{:>9}{:>7}{:>6}\n", run.name, ms(run.latency.p50_us),
        ms(run.latency.p99_us), ms(run.latency.max_us), ms(run.predicted.makespan),
        fmt::format("{:+.1f} %", 100 * (ratio(run.latency.p50_us, run.predicted.makespan) - 1)),
        base == nullptr ? ""
                        : fmt::format("{:.2f}", ratio(base->latency.p99_us, run.latency.p99_us)),
        run.latency.count);
  }
  if (base != nullptr)
    out += "\n  p99 x: how many times lower the p99 is than under the ROS 2 model.\n";
  for (const PolicyRun& run : runs) {
    if (run.scheduling == runtime::Scheduling::kXAuto)
      out += fmt::format("  {}: coordinators used {:.2f} % of one CPU\n", run.name,
                         coordinators_cpu_pct(run));
    if (const std::uint64_t lost = lost_releases(run))
      out += fmt::format("  {}: {} activations were lost\n", run.name, lost);
    if (!flags.deployment_path.empty() || run.report.num_releases == 0) out += limits_table(run);
    if (run.report.deadline_misses > 0)
      out += fmt::format("  {}: {} deadline misses\n", run.name, run.report.deadline_misses);
    if (run.outcome.trace.lost > 0)
      out += fmt::format("  {}: the trace lost {} events\n", run.name, run.outcome.trace.lost);
    if (run.outcome.trace.overwritten > 0)
      out += fmt::format(
          "  {}: the trace holds the last {:.1f} s of {:.1f} s; {} older events were dropped "
          "(--trace-keep)\n",
          run.name, traced_s(run.outcome.trace), run.outcome.wall_s, run.outcome.trace.overwritten);
    if (!run.report.note.empty()) out += fmt::format("  {}: {}\n", run.name, run.report.note);
    for (const std::string& note : run.outcome.notes)
      out += fmt::format("  {}: {}\n", run.name, note);
  }
  return out;
}

namespace {

Result<std::string> perfetto(const RunFlags& flags, const PolicyRun& run,
                             const trace::Recording& trace, std::vector<ModuleInfo> modules) {
  Scene scene;
  scene.title = flags.app.name + " on " + flags.spec.name + ": " + run.name;
  scene.note = fmt::format("{} XPUs, {}", flags.emulated ? "emulated" : "real",
                           runtime::to_string(run.scheduling));
  Rows rows = rows_of(flags.spec, run.scheduling);
  for (std::string& name : rows.names) scene.rows.push_back({std::move(name), true});
  scene.row_of = std::move(rows.of);
  // Without our coordinators jobs share an XPU, and on real CPUs the kernel preempts unseen.
  for (std::size_t x = 0; x < flags.spec.xpus.size(); ++x) {
    const Xpu& xpu = flags.spec.xpus[x];
    const auto& lost = run.report.lost_coordinators;
    if (run.scheduling != runtime::Scheduling::kXAuto ||
        runtime::discipline_of(xpu, flags.emulated) == coord::Discipline::kKernel ||
        std::find(lost.begin(), lost.end(), xpu.id) != lost.end())
      scene.rows[static_cast<std::size_t>(scene.row_of[x])].exclusive = false;
  }
  scene.modules = std::move(modules);
  if (run.policy)
    for (const Placement& p : run.policy->placements) scene.priorities.push_back(p.priority);
  scene.plan = run.predicted.slices;
  XAUTO_ASSIGN(const Story story, story_of(flags.app, flags.spec, scene.modules, trace));
  return perfetto_trace(flags.app, scene, story, boottime_offset_ns());
}

/// Who the modules of a trace are, from its own jobs: index and XNode come together in them.
std::vector<ModuleInfo> modules_in(const AppSpec& app, const trace::Recording& trace) {
  std::vector<ModuleInfo> modules;
  for (const trace::Event& e : trace.events) {
    if (e.module == XAUTO_EV_NONE) continue;
    if (e.module >= modules.size()) modules.resize(std::size_t{e.module} + 1);
    if (e.xnode < app.xnodes.size()) modules[e.module].name = app.xnodes[e.xnode].module;
  }
  for (ModuleInfo& module : modules)
    module.sink = std::none_of(app.edges.begin(), app.edges.end(), [&](const auto& edge) {
      const std::string& from = app.xnodes[static_cast<std::size_t>(edge.first)].module;
      return from == module.name &&
             app.xnodes[static_cast<std::size_t>(edge.second)].module != from;
    });
  return modules;
}

}  // namespace

Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run) {
  std::vector<ModuleInfo> modules;
  for (const runtime::ModuleReport& module : run.report.modules)
    modules.push_back({module.name, module.sink});
  return perfetto(flags, run, run.outcome.trace, std::move(modules));
}

Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run,
                                const runtime::Incident& incident) {
  return perfetto(flags, run, incident.trace, modules_in(flags.app, incident.trace));
}

std::string words_of(const RunFlags& flags, const runtime::Incident& incident) {
  const trace::Event& e = incident.event;
  if (incident.hang)
    return fmt::format("{} ran past its hang limit of {} ms in activation {}",
                       e.xnode < flags.app.xnodes.size() ? flags.app.xnodes[e.xnode].name : "a job",
                       e.arg, e.seq);
  return fmt::format("release {} missed its deadline: {:.2f} ms", e.seq,
                     static_cast<double>(e.arg) / 1000);
}

Timeline timeline_of(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  Timeline timeline;
  timeline.title = flags.app.name + " on " + flags.spec.name;
  timeline.note = fmt::format(
      "{} XPUs, {} activations per policy; each chart shows the activation of median latency",
      flags.emulated ? "emulated" : "real", runs.empty() ? 0 : runs.front().latency.count);
  for (const PolicyRun& run : runs) timeline.panels.push_back(panel_of(flags, run));
  return timeline;
}

}  // namespace xauto::cli

// SPDX-License-Identifier: Apache-2.0
#include "xauto/metrics.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "session/distribution.h"

namespace xauto::cli {
namespace {

using Labels = std::vector<std::pair<const char*, std::string>>;

/// `\`, `"` and line ends are escaped.
std::string label_value(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\' || c == '"') out += '\\';
    out += c == '\n' ? std::string("\\n") : std::string(1, c);
  }
  return out;
}

std::string in_braces(const Labels& labels) {
  std::string out;
  for (const auto& [name, value] : labels)
    out += fmt::format("{}{}=\"{}\"", out.empty() ? "" : ",", name, label_value(value));
  return out.empty() ? out : "{" + out + "}";
}

/// Microseconds as seconds, exact.
std::string seconds(std::int64_t us) {
  const std::int64_t size = us < 0 ? -us : us;
  std::string text =
      fmt::format("{}{}.{:06}", us < 0 ? "-" : "", size / 1'000'000, size % 1'000'000);
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return text;
}

/// All metrics, each with its lines together, in the order in which they are first named.
class Page {
 public:
  void gauge(const std::string& name, const char* help, const Labels& labels, std::string value) {
    add(name, "gauge", help, in_braces(labels), std::move(value));
  }
  void counter(const std::string& name, const char* help, const Labels& labels,
               std::uint64_t value) {
    add(name, "counter", help, in_braces(labels), std::to_string(value));
  }
  void counter_seconds(const std::string& name, const char* help, const Labels& labels,
                       std::int64_t us) {
    add(name, "counter", help, in_braces(labels), seconds(us));
  }
  void histogram(const std::string& name, const char* help, const Labels& labels,
                 const FlowCounts& flow) {
    Metric& metric = metric_of(name, "histogram", help);
    // A result may come between two reads of the board: the buckets are the count.
    const std::map<std::uint32_t, std::uint64_t> buckets = flow.latency_us.buckets();
    std::uint64_t below = 0;
    auto next = buckets.begin();
    for (const std::int64_t bound_us : latency_bounds_us()) {
      // A time is kept in whole microseconds, rounded down: those below the bound are below it.
      const std::uint32_t last = runtime::Distribution::bucket_of(bound_us - 1);
      for (; next != buckets.end() && next->first <= last; ++next) below += next->second;
      Labels with = labels;
      with.emplace_back("le", seconds(bound_us));
      metric.lines += fmt::format("{}_bucket{} {}\n", name, in_braces(with), below);
    }
    Labels with = labels;
    with.emplace_back("le", "+Inf");
    const std::uint64_t total = flow.results();
    metric.lines += fmt::format("{}_bucket{} {}\n{}_sum{} {}\n{}_count{} {}\n", name,
                                in_braces(with), total, name, in_braces(labels),
                                seconds(flow.latency_us.sum()), name, in_braces(labels), total);
  }
  [[nodiscard]] std::string text() const {
    std::string out;
    for (const Metric& metric : metrics_)
      out += fmt::format("# HELP {} {}\n# TYPE {} {}\n{}", metric.name, metric.help, metric.name,
                         metric.type, metric.lines);
    return out;
  }

 private:
  struct Metric {
    std::string name;
    const char *type, *help;
    std::string lines;
  };
  Metric& metric_of(const std::string& name, const char* type, const char* help) {
    const auto [at, is_new] = index_.try_emplace(name, metrics_.size());
    if (is_new) metrics_.push_back({name, type, help, {}});
    return metrics_[at->second];
  }
  void add(const std::string& name, const char* type, const char* help, const std::string& labels,
           std::string value) {
    metric_of(name, type, help).lines += name + labels + " " + std::move(value) + "\n";
  }
  std::vector<Metric> metrics_;
  std::map<std::string, std::size_t> index_;
};

/// A chain, or with the prefix "xauto_release" the app as a whole. `stands`: the policy's claims are
/// about a run like this.
void add_flow(Page& page, const std::string& prefix, const Labels& labels, const FlowCounts& flow,
              bool stands, bool worst_case_of_all) {
  page.histogram(prefix + "_latency_seconds", "Latency, end to end.", labels, flow);
  const auto measured = [&](const char* name, const char* help, std::int64_t us) {
    if (us >= 0) page.gauge(prefix + name, help, labels, seconds(us));
  };
  measured("_last_latency_seconds", "Latency of the last result.", flow.last_us);
  measured("_longest_latency_seconds", "Longest latency since the run began.", flow.longest_us);
  page.counter(prefix + "_deadline_misses_total", "Results later than the deadline.", labels,
               flow.deadline_misses);
  page.counter(prefix + "_lost_total", "Activations that failed or were dropped.", labels,
               flow.lost);
  if (flow.deadline_us > 0)
    page.gauge(prefix + "_deadline_seconds", "Deadline, as it is stated.", labels,
               seconds(flow.deadline_us));
  if (flow.max_age_us > 0) {
    page.gauge(prefix + "_age_limit_seconds", "Oldest age that is allowed, as it is stated.",
               labels, seconds(flow.max_age_us));
    page.counter(prefix + "_age_misses_total", "Results that became older than allowed.", labels,
                 flow.age_misses);
  }
  if (flow.worst_case_us == 0) return;
  page.counter(prefix + "_over_worst_case_total",
               "Results that took longer than what the policy claims.", labels, flow.over_claim);
  if (!stands) return;
  page.gauge(prefix + "_worst_case_seconds",
             "Certified worst case; absent where nothing is claimed of this run.", labels,
             seconds(flow.worst_case_us));
  if (worst_case_of_all && flow.longest_us >= 0)
    page.gauge(prefix + "_slack_seconds", "Certified worst case less the longest latency.", labels,
               seconds(flow.worst_case_us - flow.longest_us));
}

void add_scenarios(Page& page, const Labels& of_run, const Counts& counts) {
  if (!counts.scenario) return;
  page.counter("xauto_table_switches_total", "Changes to another table.", of_run,
               counts.scenario->switches);
  for (const ScenarioCounts& s : counts.scenarios) {
    if (s.name.empty()) continue;  // the run is about to begin, and names them
    Labels labels = of_run;
    labels.emplace_back("scenario", s.name);
    labels.emplace_back("table", s.table);
    page.gauge("xauto_scenario_active", "1: the scenario counts now.", labels,
               s.name == counts.scenario->name ? "1" : "0");
    page.counter("xauto_scenario_releases_total", "Releases under it.", labels, s.releases);
  }
}

void add_crossings(Page& page, const Labels& of_run, const Counts& counts) {
  for (const CrossingCounts& of : counts.crossings) {
    Labels labels = of_run;
    labels.insert(labels.end(), {{"xnode", of.xnode}, {"from", of.from}, {"to", of.to}});
    page.counter("xauto_crossing_messages_total",
                 "Messages of other hosts that were here by their X.", labels, of.messages);
    page.counter("xauto_crossing_lost_total", "Messages of other hosts that were not.", labels,
                 of.lost);
    page.gauge("xauto_crossing_x_seconds", "Time from the sender's key, as it is assumed.", labels,
               seconds(of.x_us));
    if (of.messages > 0)
      page.gauge("xauto_crossing_longest_seconds",
                 "Longest time from the sender's key, by this host's clock.", labels,
                 seconds(of.longest_us));
  }
}

void add_xpus(Page& page, const Labels& of_run, const RunLook& look) {
  const auto labels_of = [&](const std::string& xpu) {
    Labels labels = of_run;
    labels.emplace_back("xpu", xpu);
    return labels;
  };
  for (const XpuCounts& xpu : look.counts.xpus) {
    const Labels labels = labels_of(xpu.name);
    page.counter_seconds("xauto_xpu_busy_seconds_total",
                         "Time for which jobs that ended had the XPU; its rate is the utilisation.",
                         labels, xpu.busy_ns / 1000);
    page.counter("xauto_xpu_suspensions_total", "Times that a backend suspended a job's work.",
                 labels, xpu.suspensions);
  }
  for (const XpuStatus& xpu : look.xpus) {
    const Labels labels = labels_of(xpu.xpu);
    std::uint64_t running = 0, waiting = 0;
    for (const WorkerStatus& worker : xpu.workers)
      if (!worker.idle() && worker.state != "starting")
        ++(worker.state == "running" ? running : waiting);
    page.gauge("xauto_xpu_running_jobs", "Jobs that have the XPU at this moment.", labels,
               std::to_string(running));
    page.gauge("xauto_xpu_waiting_jobs", "Jobs that wait or are suspended at this moment.", labels,
               std::to_string(waiting));
    page.counter("xauto_coordinator_decisions_total", "Decisions of the XPU's coordinator.", labels,
                 xpu.decisions);
  }
}

void add_metrics_of(Page& page, const RunLook& look) {
  const Counts& counts = look.counts;
  const Labels of_run = {{"app", look.app}, {"run", look.run}};
  const auto with = [&](const char* name, const std::string& value) {
    Labels labels = of_run;
    labels.emplace_back(name, value);
    return labels;
  };
  Labels info = with("platform", look.platform);
  info.emplace_back("scheduling", look.scheduling);
  if (!look.host.empty()) info.emplace_back("host", look.host);
  page.gauge("xauto_run_info", "A run that goes on.", info, "1");
  page.counter("xauto_releases_total", "Releases of the sensors.", of_run, counts.released);
  const bool stands = counts.account.stands();
  if (counts.account.claims())
    page.gauge("xauto_claim_stands",
               "1: nothing that is watched breaks what the certified worst cases take for granted.",
               of_run, stands ? "1" : "0");
  for (const runtime::Assumption& assumption : counts.account.assumptions)
    page.counter("xauto_assumption_violations_total",
                 "What certified worst cases take for granted and this run did not keep.",
                 with("kind", assumption.kind), assumption.count);
  if (counts.single_rate())
    add_flow(page, "xauto_release", of_run, counts.whole, stands, counts.scenarios.empty());
  for (const FlowCounts& chain : counts.chains)
    add_flow(page, "xauto_chain", with("chain", chain.name), chain, stands, true);
  for (const ModuleCounts& module : counts.modules) {
    const Labels labels = with("module", module.name);
    page.counter("xauto_module_activations_total", "Activations that ended well.", labels,
                 module.activations);
    page.counter("xauto_module_failures_total", "Activations whose exec failed.", labels,
                 module.failed);
    page.counter("xauto_module_drops_total", "Activations that were dropped.", labels,
                 module.dropped);
    page.counter("xauto_module_off_total", "Releases in whose table the module is off.", labels,
                 module.off);
    page.counter("xauto_module_skips_total",
                 "Releases that it, or a module before it, skipped as it was told.", labels,
                 module.skipped);
    page.counter("xauto_module_process_deaths_total", "Deaths of the module's process.", labels,
                 module.deaths);
  }
  add_scenarios(page, of_run, counts);
  add_crossings(page, of_run, counts);
  add_xpus(page, of_run, look);
}

void add_machine(Page& page, const MachineXpu& xpu) {
  if (xpu.slack_pct)
    page.gauge("xauto_machine_slack_ratio",
               "What the demands of all apps that have joined leave of the XPU.",
               {{"xpu", xpu.xpu}},
               fmt::format("{:.2f}", static_cast<double>(*xpu.slack_pct) / 100));
  for (const AppOnXpu& app : xpu.apps) {
    const Labels labels = {{"app", app.app},
                           {"lease", std::to_string(app.lease)},
                           {"uid", std::to_string(app.uid)},
                           {"xpu", xpu.xpu}};
    page.gauge("xauto_machine_admitted_ratio", "What the app's demand asks of the XPU's time.",
               labels, fmt::format("{:.4f}", app.admitted_pct / 100));
    page.counter_seconds("xauto_machine_had_seconds_total",
                         "Time for which jobs that ended had the XPU, of workers that are there.",
                         labels, app.had_us);
  }
}

}  // namespace

std::vector<std::int64_t> latency_bounds_us() {
  // 128 us to 8.4 s, two a power of two: the board's buckets end at both.
  std::vector<std::int64_t> bounds;
  for (std::int64_t us = 128; us < 8'388'608; us *= 2) {
    bounds.push_back(us);
    bounds.push_back(us + us / 2);
  }
  bounds.push_back(8'388'608);
  return bounds;
}

std::string metrics_text(const std::vector<RunLook>& runs, const std::vector<MachineXpu>& machine) {
  Page page;
  page.gauge("xauto_build_info", "The version of the exporter.", {{"version", XAUTO_VERSION}}, "1");
  page.gauge("xauto_runs", "Runs that go on and are exported here.", {},
             std::to_string(runs.size()));
  for (const RunLook& look : runs) add_metrics_of(page, look);
  for (const MachineXpu& xpu : machine) add_machine(page, xpu);
  return page.text();
}

}  // namespace xauto::cli

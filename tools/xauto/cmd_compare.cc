// SPDX-License-Identifier: Apache-2.0
// xauto compare: one app under several policies, side by side: the table, report.json,
// timeline.html, a Perfetto trace each.
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iostream>

#include <sys/stat.h>

#include "base/log.h"
#include "model/json.h"
#include "solver/solve.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/report.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct CompareFlags : RunFlags {
  std::vector<std::string> policies = {"ros2", "heft", "xauto", "xauto-unscheduled"};
  std::string out = "compare";
  double time_limit_s = 10;
};

const std::vector<std::pair<std::string, std::string>> kNames = {
    {"ros2", "ROS 2 model"},
    {"heft", "HEFT"},
    {"local", "local optimum, scheduled"},
    {"xauto", "XAuto"},
    {"xauto-unscheduled", "XAuto without scheduling"}};

std::string name_of(const std::string& id) {
  for (const auto& [known, name] : kNames)
    if (known == id) return name;
  return id;
}

/// `solved`: XAuto's policy, solved once for the runs with and without scheduling.
Result<PolicyRun> prepare(const CompareFlags& flags, const std::string& id,
                          std::optional<Policy>& solved, Outputs& outputs) {
  PolicyRun run;
  run.id = id;
  run.name = name_of(id);
  if (id == "ros2") {
    run.scheduling = runtime::Scheduling::kRos2;
  } else {
    const bool ours = id == "xauto" || id == "xauto-unscheduled";
    if (id == "xauto-unscheduled") run.scheduling = runtime::Scheduling::kTimeshare;
    if (ours) run.policy = solved;
    if (!run.policy) {
      solver::SolveOptions options;
      options.method = ours ? "auto" : id;
      options.time_limit_s = flags.time_limit_s;
      options.threads = 2;
      XAUTO_ASSIGN(run.policy, solver::solve(flags.app, flags.spec, options));
      if (ours) solved = run.policy;
    }
    const std::string path = flags.out + "/" + id + ".policy.json";
    outputs.write(path, to_json(*run.policy, flags.app, flags.spec));
    XAUTO_TRY(xpu::check_placements(flags.app, flags.spec, flags.presence, *run.policy, path));
  }
  XAUTO_ASSIGN(run.predicted, predict(flags.app, flags.spec, run.scheduling, run.policy));
  return run;
}

Result<int> compare(const CompareFlags& given, const Options& options) {
  CompareFlags flags = given;
  XAUTO_TRY(flags.prepare());
  XAUTO_TRY(require_version_1(flags.app, flags.app_path));
  std::error_code error;
  std::filesystem::create_directories(flags.out, error);
  if (error) return fail(ErrorCode::kIo, "cannot make the folder: " + error.message(), flags.out);
  Outputs outputs;
  const std::string report_path = flags.out + "/report.json";
  const std::string timeline_path = flags.out + "/timeline.html";
  XAUTO_TRY(outputs.expect("--out", report_path));
  XAUTO_TRY(outputs.expect("--out", timeline_path));

  std::vector<PolicyRun> runs;
  std::optional<Policy> solved;
  bool good = true;
  const StopOnSignal stop;
  for (const std::string& id : flags.policies) {
    XAUTO_ASSIGN(PolicyRun run, prepare(flags, id, solved, outputs));
    log::info("{}: {:.2f} ms simulated, running {} activations", run.name,
              static_cast<double>(run.predicted.makespan) / 1000, flags.activations);
    XAUTO_TRY(execute(flags, run, stop.flag()));
    good = is_healthy(run) && good;
    if (const Result<std::string> trace = perfetto_of(flags, run))
      outputs.write(flags.out + "/" + id + ".pftrace", *trace);
    else
      outputs.failed(trace.error());
    runs.push_back(std::move(run));
    if (stop.flag()->load()) break;
  }
  const std::string report = report_json(flags, runs);
  if (options.json)
    std::cout << report;
  else
    std::cout << report_table(flags, runs) << "\n";
  outputs.write(report_path, report);
  outputs.write(timeline_path, timeline_html(timeline_of(flags, runs)));
  if (!options.json && outputs.good())
    std::cout << "  " << report_path << "    the numbers\n  " << timeline_path
              << "  the schedules; open it in a browser\n  " << flags.out
              << "/*.pftrace      what ran, all of it; open one at ui.perfetto.dev\n";
  return outputs.status(good ? kDone : kAnswerIsNo);
}

}  // namespace

void add_compare(Commands& commands) {
  auto flags = std::make_shared<CompareFlags>();
  Verb verb = commands.add(
      "compare", "Run an app under several policies and compare their end-to-end latency.",
      "xauto compare --app app.json --platform small --out build/demo -- build/bin/driving",
      [flags](const Options& options) { return compare(*flags, options); });
  flags->declare(verb);
  std::vector<std::string> known;
  for (const auto& [id, name] : kNames) known.push_back(id);
  verb.option("--policies", flags->policies, "which, in this order")
      .separated_by(',')
      .one_of(known)
      .shown();
  verb.option("--out", flags->out,
              "folder for report.json, timeline.html, the traces and the policies")
      .shown();
  verb.option("--time-limit-s", flags->time_limit_s, "for the solver, per policy")
      .positive()
      .shown();
}

}  // namespace xauto::cli

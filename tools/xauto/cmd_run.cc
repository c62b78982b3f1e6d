// SPDX-License-Identifier: Apache-2.0
// xauto run: an app under one policy, with its coordinators.
#include <filesystem>
#include <iostream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/log.h"
#include "model/json.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/report.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct Flags : RunFlags {
  std::string policy_path, scheduling = "xauto", out, timeline, trace_out, record;
};

Result<int> run(const Flags& given, const Options& options) {
  Flags flags = given;
  XAUTO_TRY(flags.prepare());
  PolicyRun run;
  run.scheduling = *runtime::scheduling_from(flags.scheduling);
  if (run.scheduling == runtime::Scheduling::kRos2) {
    run.id = "ros2";
    run.name = "ROS 2 model";
  } else {
    if (flags.policy_path.empty())
      return fail(ErrorCode::kInvalid, "is needed unless --scheduling ros2", "--policy",
                  "make one with `xauto solve --app " + flags.app_path + " --platform " +
                      flags.platform + " --out policy.json`");
    XAUTO_ASSIGN(run.policy, load_policy(flags.policy_path, flags.app, flags.spec));
    run.id = run.policy->method;
    run.name = run.policy->method;
  }
  flags.record_path = flags.record;
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_TRY(outputs.expect("--timeline", flags.timeline));
  XAUTO_TRY(outputs.expect("--trace-out", flags.trace_out));
  // One that exists is refused by the app's recorder, which also makes folders ("drive/").
  if (!std::filesystem::exists(flags.record))
    XAUTO_TRY(
        outputs.expect("--record", flags.record.substr(0, flags.record.find_last_not_of('/') + 1)));
  XAUTO_ASSIGN(run.predicted, predict(flags.app, flags.spec, run.scheduling, run.policy));
  const StopOnSignal stop;
  XAUTO_TRY(execute(flags, run, stop.flag()));

  const std::vector<PolicyRun> runs = {run};
  const std::string report = report_json(flags, runs);
  if (options.json)
    std::cout << report;
  else
    std::cout << report_table(flags, runs);
  outputs.write(flags.out, report);
  if (!flags.timeline.empty())
    outputs.write(flags.timeline, timeline_html(timeline_of(flags, runs)));
  if (!flags.trace_out.empty()) {
    if (const Result<std::string> trace = perfetto_of(flags, run))
      outputs.write(flags.trace_out, *trace);
    else
      outputs.failed(trace.error());
  }
  if (!run.report.recording_error.empty())
    outputs.failed({ErrorCode::kIo, run.report.recording_error, "--record " + flags.record, {}});
  return outputs.status(healthy(run) ? kDone : kAnswerIsNo);
}

}  // namespace

void add_run(Commands& commands) {
  auto flags = std::make_shared<Flags>();
  CLI::App* verb = commands.add(
      "run", "Run an app under a policy and measure its end-to-end latency.",
      "xauto run --app app.json --policy policy.json --platform small -- build/bin/driving",
      [flags](const Options& options) { return run(*flags, options); });
  flags->declare(*verb);
  verb->add_option("--policy", flags->policy_path, "policy.json from `xauto solve`");
  verb->add_option("--scheduling", flags->scheduling,
                   "xauto: as the policy says; timeshare: its assignment, nobody schedules; ros2: "
                   "everybody on his fastest XPU, nobody schedules")
      ->check(CLI::IsMember({"xauto", "timeshare", "ros2"}))
      ->capture_default_str();
  verb->add_option("--out", flags->out, "write report.json here");
  verb->add_option("--timeline", flags->timeline, "write the schedule as an HTML page here");
  verb->add_option("--trace-out", flags->trace_out,
                   "write what ran here, for Perfetto's viewers (FILE.pftrace)");
  verb->add_option("--record", flags->record, "record the sources' messages here (rosbag2 layout)");
}

}  // namespace xauto::cli

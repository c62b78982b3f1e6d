// SPDX-License-Identifier: Apache-2.0
// xauto run: an app under one policy, with its coordinators.
#include <filesystem>
#include <iostream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/log.h"
#include "model/json.h"

#include "xauto/command.h"
#include "xauto/report.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct Flags : RunFlags {
  std::string policy_path, scheduling = "xauto", name, out, timeline, trace_out, record;
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
    XAUTO_TRY(
        check_placements(flags.app, flags.spec, flags.presence, *run.policy, flags.policy_path));
    run.id = run.name = std::filesystem::path(flags.policy_path).stem().string();
  }
  if (!flags.name.empty()) run.id = run.name = flags.name;
  flags.record_path = flags.record;
  XAUTO_ASSIGN(run.predicted, predict(flags.app, flags.spec, run.scheduling, run.policy));
  const StopOnSignal stop;
  XAUTO_TRY(execute(flags, run, stop.flag()));

  const std::vector<PolicyRun> runs = {run};
  const std::string report = report_json(flags, runs);
  if (!flags.out.empty()) XAUTO_TRY(write_file(flags.out, report));
  if (!flags.timeline.empty())
    XAUTO_TRY(write_file(flags.timeline, timeline_html(timeline_of(flags, runs))));
  if (!flags.trace_out.empty()) {
    XAUTO_ASSIGN(const std::string trace, perfetto_of(flags, run));
    XAUTO_TRY(write_file(flags.trace_out, trace));
  }
  if (options.json)
    std::cout << report;
  else
    std::cout << report_table(flags, runs);
  return healthy(run) ? kDone : kAnswerIsNo;
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
  verb->add_option("--name", flags->name,
                   "what the run is called in tables, pages and report.json; default: the policy's "
                   "file without folder and suffix");
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

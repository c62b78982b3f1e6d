// SPDX-License-Identifier: Apache-2.0
// xauto run: an app under one policy, with its coordinators.
#include <array>
#include <filesystem>
#include <iostream>

#include <fmt/format.h>

#include "base/log.h"
#include "model/json.h"
#include "solver/keys/check.h"
#include "solver/keys/check_tables.h"

#include "xauto/command.h"
#include "xauto/gate.h"
#include "xauto/outputs.h"
#include "xauto/parts.h"
#include "xauto/report.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct OneRunFlags : RunFlags {
  std::string policy_path, scheduling = "xauto", name, out, page, trace_out, record;
};

/// "run.pftrace" -> "run.miss-1.pftrace"
std::string dump_path(const std::string& trace_out, bool hang, int number) {
  const std::string suffix = ".pftrace";
  const std::string stem = trace_out.ends_with(suffix)
                               ? trace_out.substr(0, trace_out.size() - suffix.size())
                               : trace_out;
  return fmt::format("{}.{}-{}{}", stem, hang ? "hang" : "miss", number, suffix);
}

/// Of tables.json: the run begins under the first scenario.
Status take_tables(const OneRunFlags& flags, PolicyRun& run) {
  if (run.scheduling != runtime::Scheduling::kXAuto)
    return fail(ErrorCode::kInvalid, "is of a run that nobody schedules, and tables are scheduled",
                "--scheduling " + flags.scheduling, "give --policy a policy.json");
  XAUTO_ASSIGN(run.tables, load_tables(flags.policy_path, flags.app, flags.spec));
  XAUTO_TRY(
      xpu::check_placements(flags.app, flags.spec, flags.presence, *run.tables, flags.policy_path));
  const auto first = static_cast<std::size_t>(run.tables->serves.front().table);
  run.policy = whole_policy(*run.tables, first, flags.app, flags.spec);
  return {};
}

/// The first statement that `xauto check` refuses; empty: none.
std::string refused_by_check(const OneRunFlags& flags, const PolicyRun& run) {
  if (run.keys) {
    const auto checked = solver::keys::check(flags.app, flags.spec, *run.keys);
    // What takes too long to derive, or makes no sense to check, is not refused by it.
    return checked || checked.error().code != ErrorCode::kInfeasible ? ""
                                                                     : checked.error().to_string();
  }
  if (!run.tables) return {};  // priorities claim nothing
  const std::vector<std::string> lies =
      solver::keys::examine_tables(flags.app, flags.spec, *run.tables).lies;
  return lies.empty() ? "" : lies.front();
}

/// As `xauto check`: XPUs of one name may be anything on another platform.
Status check_platform(const OneRunFlags& flags, const std::string& made_for) {
  const std::string& platform = flags.spec.name;
  if (made_for.empty() || made_for == platform) return {};
  return fail(ErrorCode::kInvalid,
              "was made for platform '" + made_for + "', and this run is on '" + platform + "'",
              flags.policy_path,
              "give --platform " + made_for + ", or make a policy for '" + platform +
                  "' with `xauto solve`");
}

/// A policy that was edited is worth a run; its worst cases are not.
void warn_of_untrue_claims(const OneRunFlags& flags, PolicyRun& run) {
  if (run.scheduling != runtime::Scheduling::kXAuto) return;
  if (run.uncertified()) return;
  run.untrue = refused_by_check(flags, run);
  if (!run.untrue.empty())
    log::warn(
        "{}: `xauto check` refuses it here: {} (`xauto solve` makes a policy for this app and "
        "platform)",
        flags.policy_path, run.untrue);
}

/// The trace, and the page that is made of it.
void write_traced(const OneRunFlags& flags, const PolicyRun& run, Outputs& outputs) {
  const Result<std::string> trace = perfetto_of(flags, run);
  if (!trace) return outputs.failed(trace.error());
  if (!flags.trace_out.empty()) outputs.write(flags.trace_out, *trace);
  if (flags.page.empty()) return;
  auto page =
      paged_of(*trace, flags.trace_out.empty() ? "" : link_from(flags.page, flags.trace_out));
  if (!page) return outputs.failed(page.error());
  outputs.write(flags.page, story::page_html({std::move(*page)}));
}

Result<int> run(const OneRunFlags& given, const Options& options) {
  OneRunFlags flags = given;
  XAUTO_TRY(flags.prepare(flags.policy_path));
  std::vector<PolicyRun> runs(1);
  PolicyRun& run = runs.front();
  run.scheduling = *runtime::scheduling_from(flags.scheduling);
  if (run.scheduling == runtime::Scheduling::kRos2) {
    run.id = "ros2";
    run.name = "ROS 2 model";
  } else {
    if (flags.policy_path.empty())
      return fail(ErrorCode::kInvalid, "is needed unless --scheduling ros2", "--policy",
                  "make one with `xauto solve --app " + flags.app_path + " --platform " +
                      flags.spec.name + " --out policy.json`");
    if (is_tables_file(flags.policy_path)) {
      XAUTO_TRY(take_tables(flags, run));
      XAUTO_TRY(check_platform(flags, run.tables->platform));
    } else {
      XAUTO_ASSIGN(Policy policy, load_policy(flags.policy_path, flags.app, flags.spec));
      XAUTO_TRY(check_platform(flags, policy.platform));
      run.take(std::move(policy));
    }
    if (flags.part.empty())
      XAUTO_TRY(xpu::check_placements(flags.app, flags.spec, flags.presence, *run.policy,
                                      flags.policy_path));
    else
      XAUTO_TRY(check_part(flags, run));
    warn_of_untrue_claims(flags, run);
    run.id = run.name = std::filesystem::path(flags.policy_path).stem().string();
  }
  if (!flags.name.empty()) run.id = run.name = flags.name;
  XAUTO_TRY(check_gate(flags, run));
  if (flags.record_outputs && flags.record.empty())
    return fail(ErrorCode::kInvalid, "has no recording", "--record-outputs",
                "say where to: --record drive.mcap");
  flags.record_path = flags.record;
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_TRY(outputs.expect("--page", flags.page));
  XAUTO_TRY(outputs.expect("--trace-out", flags.trace_out));
  // One that exists is refused by the app's recorder, which also makes folders ("drive/").
  if (!std::filesystem::exists(flags.record))
    XAUTO_TRY(
        outputs.expect("--record", flags.record.substr(0, flags.record.find_last_not_of('/') + 1)));
  const StopOnSignal stop;
  Dump dump;
  if (!flags.trace_out.empty())
    dump = [&, count = std::array<int, 2>{}](const launch::Incident& incident) mutable {
      const int number = ++count[incident.hang ? 1 : 0];
      const std::string path = dump_path(flags.trace_out, incident.hang, number);
      const Result<std::string> trace = perfetto_of(flags, run, incident);
      if (!trace) return outputs.failed(trace.error());
      outputs.write(path, *trace);
      log::warn("{}; what went on around it is in {}", words_of(flags, incident), path);
    };
  XAUTO_TRY(execute(flags, run, stop.flag(), std::move(dump)));

  const std::string report = report_json(flags, runs);
  if (options.json)
    std::cout << report;
  else
    std::cout << report_table(flags, runs);
  outputs.write(flags.out, report);
  if (!flags.page.empty() || !flags.trace_out.empty()) write_traced(flags, run, outputs);
  if (!run.report.recording_error.empty())
    outputs.failed({ErrorCode::kIo, run.report.recording_error, "--record " + flags.record, {}});
  bool passed = is_healthy(run);
  for (const GateCount& gate : gate_of(flags, run)) {
    if (gate.count == 0) continue;
    log::error("--fail-on {}: {}", gate.word, gate.what);
    passed = false;
  }
  return outputs.status(passed ? kDone : kAnswerIsNo);
}

}  // namespace

void add_run(Commands& commands) {
  auto flags = std::make_shared<OneRunFlags>();
  Verb verb = commands.add("run", "Run an app under a policy and measure its end-to-end latency.",
                           "xauto run --app app.json --policy policy.json -- build/bin/driving",
                           [flags](const Options& options) { return run(*flags, options); });
  flags->declare(verb);
  Argument part = verb.option(
      "--part", flags->part,
      "run only what the policy has on this host of the platform; the other hosts run their parts "
      "(docs/several-machines.md)");
  verb.option("--meet", flags->meet,
              "ADDRESS:PORT where the parts meet: the first of the platform's hosts with XNodes "
              "listens there")
      .needs("--part");
  part.needs("--meet");
  verb.duration("--meet-limit", flags->meet_limit_s, Unit::kSeconds, 1, 86'400,
                "with --part: how long to wait for the others")
      .needs("--part")
      .shown();
  verb.option(
      "--policy", flags->policy_path,
      "policy.json from `xauto solve`, or tables.json: each release gets one of its policies");
  verb.option("--name", flags->name,
              "what the run is called in tables, pages and report.json; default: the policy's "
              "file without folder and suffix");
  verb.option("--scheduling", flags->scheduling,
              "xauto: as the policy says; timeshare: its assignment, nobody schedules; ros2: "
              "each stage on its fastest XPU, nobody schedules")
      .one_of({"xauto", "timeshare", "ros2"})
      .shown();
  verb.option("--out", flags->out, "write report.json here");
  verb.option(
      "--page", flags->page,
      "write a page here: what became of the claims, and where the time of each chain went");
  verb.option("--trace-out", flags->trace_out,
              "write what ran here, for Perfetto's viewers (FILE.pftrace); what surrounds the "
              "first three deadline misses and hangs goes to FILE.miss-1.pftrace, "
              "FILE.hang-1.pftrace, ... at once");
  verb.option("--fail-on", flags->fail_on,
              "exit status 1 if the run had any of these: miss (deadlines), lost "
              "(activations), hang, restart (processes that died), claim (worst cases that "
              "results took longer than)")
      .separated_by(',')
      .one_of(kGateWords);
  verb.option("--record", flags->record,
              "record the sources' messages here: .mcap, or a rosbag2 folder");
  verb.flag("--record-outputs", flags->record_outputs,
            "with --record: what modules publish, too, where their types can be encoded");
}

}  // namespace xauto::cli

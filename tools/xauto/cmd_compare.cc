// SPDX-License-Identifier: Apache-2.0
// xauto compare: one app under several policies, side by side: the table, report.json,
// timeline.html, a Perfetto trace each.
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iostream>

#include <fmt/format.h>
#include <sys/stat.h>

#include "base/log.h"
#include "model/json.h"
#include "model/periodic.h"
#include "solver/search.h"
#include "solver/solve.h"
#include "solver/steady/check.h"
#include "solver/steady/solve.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/report.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct CompareFlags : RunFlags {
  std::vector<std::string> policies;  ///< empty: those of the app's version
  std::string out = "compare";
  double time_limit_s = 10;
};

const std::vector<std::pair<std::string, std::string>> kPolicyNames = {
    {"ros2", "ROS 2 model"},
    {"heft", "HEFT"},
    {"local", "local optimum, scheduled"},
    {"xauto", "XAuto"},
    {"xauto-unscheduled", "XAuto without scheduling"},
    {"fixed", "fixed priorities"},
    {"keys", "keys"}};

const std::vector<std::string> kVersion1 = {"ros2", "heft", "xauto", "xauto-unscheduled"};
const std::vector<std::string> kVersion2 = {"ros2", "fixed", "keys"};

std::string name_of(const std::string& id) {
  for (const auto& [known, name] : kPolicyNames)
    if (known == id) return name;
  return id;
}

/// The solver's plan of one release, with priorities by period, the shortest first (rate-monotonic): an
/// XNode counts by the slowest source that it waits for. Those of one period stay as they are among
/// themselves. It claims nothing.
Result<Policy> fixed_priorities(const AppSpec& app, const Platform& platform, double time_limit_s) {
  AppSpec once = app;
  once.sources.clear();
  for (XNodeSpec& xnode : once.xnodes) xnode.sources.clear();
  solver::SolveOptions options;
  options.time_limit_s = time_limit_s;
  options.threads = 2;
  options.priorities_only = true;
  XAUTO_ASSIGN(const Policy plan, solver::solve(once, platform, options));
  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(app, platform));
  solver::Decision decision;
  for (const Placement& p : plan.placements) {
    decision.xpu.push_back(p.xpu);
    decision.priority.push_back(p.priority);
  }
  std::vector<int> sequence = solver::sequence_of(decision.priority);
  const std::vector<std::int64_t> periods = app.periods();
  const auto period = [&](int i) {
    const std::int64_t known = periods[static_cast<std::size_t>(i)];
    return known > 0 ? known : kMaxPeriodUs + 1;
  };
  std::stable_sort(sequence.begin(), sequence.end(),
                   [&](int a, int b) { return period(a) < period(b); });
  auto priority = static_cast<std::int64_t>(sequence.size());
  for (const int i : sequence) decision.priority[static_cast<std::size_t>(i)] = priority--;
  Policy policy = solver::make_policy(app, platform, problem, decision, plan.method);
  policy.lower_bound_us = plan.lower_bound_us;
  policy.solve_ms = plan.solve_ms;
  return policy;
}

/// Of an app of version 2: by keys, or by fixed priorities.
Status solve_periodic(const CompareFlags& flags, PolicyRun& run, const std::string& path,
                      Outputs& outputs) {
  if (run.id == "fixed") {
    const AppSpec app = as_version_1(flags.app);
    XAUTO_ASSIGN(run.policy, fixed_priorities(app, flags.spec, flags.time_limit_s));
    outputs.write(path, to_json(*run.policy, app, flags.spec));
    return {};
  }
  solver::steady::Options options;
  options.time_limit_s = flags.time_limit_s;
  options.threads = 2;
  XAUTO_ASSIGN(solver::steady::Answer answer,
               solver::steady::solve(flags.app, flags.spec, options));
  if (answer.outcome != solver::steady::Outcome::kPolicy)
    return fail(ErrorCode::kInfeasible,
                answer.outcome == solver::steady::Outcome::kUnsustainable
                    ? "no policy of keys keeps up: " + answer.overload.text
                    : "no policy of keys was found in this time",
                flags.app.name + " on " + flags.spec.name, "`xauto solve` says more");
  XAUTO_TRY(solver::steady::check(flags.app, flags.spec, answer.policy));
  run.keys = std::move(answer.policy);
  run.policy = assignment_of(*run.keys);
  outputs.write(path, to_json(*run.keys, flags.app, flags.spec));
  return {};
}

/// `solved`: XAuto's policy, solved once for the runs with and without scheduling.
Result<PolicyRun> prepare(const CompareFlags& flags, const std::string& id,
                          std::optional<Policy>& solved, Outputs& outputs) {
  PolicyRun run;
  run.id = id;
  run.name = name_of(id);
  const std::string path = flags.out + "/" + id + ".policy.json";
  if (id == "ros2") {
    run.scheduling = runtime::Scheduling::kRos2;
  } else if (flags.app.version == 2) {
    XAUTO_TRY(solve_periodic(flags, run, path, outputs));
    XAUTO_TRY(xpu::check_placements(flags.app, flags.spec, flags.presence, *run.policy, path));
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
    outputs.write(path, to_json(*run.policy, flags.app, flags.spec));
    XAUTO_TRY(xpu::check_placements(flags.app, flags.spec, flags.presence, *run.policy, path));
  }
  if (flags.app.version == 1) {
    XAUTO_ASSIGN(run.predicted, predict(flags.app, flags.spec, run.scheduling, run.policy));
  }
  return run;
}

Result<int> compare(const CompareFlags& given, const Options& options) {
  CompareFlags flags = given;
  XAUTO_TRY(flags.prepare());
  const std::vector<std::string>& known = flags.app.version == 2 ? kVersion2 : kVersion1;
  if (flags.policies.empty()) flags.policies = known;
  for (const std::string& id : flags.policies)
    if ((id == "fixed" || id == "keys" || id == "ros2" ? flags.app.version == 1 && id != "ros2"
                                                       : flags.app.version == 2))
      return fail(ErrorCode::kInvalid, "'" + id + "' is not for an app of this version",
                  "--policies", fmt::format("there are {}", fmt::join(known, ",")));
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
    const std::string length = flags.seconds > 0 ? fmt::format("{:g} s", flags.seconds)
                                                 : fmt::format("{} activations", flags.activations);
    if (flags.app.version == 1)
      log::info("{}: {:.2f} ms simulated, running {}", run.name,
                static_cast<double>(run.predicted.makespan) / 1000, length);
    else
      log::info("{}: running {}", run.name, length);
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
  for (const auto& [id, name] : kPolicyNames) known.push_back(id);
  verb.option("--policies", flags->policies, "which, in this order")
      .separated_by(',')
      .one_of(known)
      .shown_as(fmt::format("{}; of an app of version 2 {}", fmt::join(kVersion1, ","),
                            fmt::join(kVersion2, ",")));
  verb.option("--out", flags->out,
              "folder for report.json, timeline.html, the traces and the policies")
      .shown();
  verb.option("--time-limit-s", flags->time_limit_s, "for the solver, per policy")
      .positive()
      .shown();
}

}  // namespace xauto::cli

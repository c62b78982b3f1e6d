// SPDX-License-Identifier: Apache-2.0
// xauto compare: one app under several policies, side by side: the table, report.json,
// report.html, a Perfetto trace each.
#include <algorithm>
#include <filesystem>
#include <iostream>

#include <fmt/format.h>
#include <sys/stat.h>

#include "base/log.h"
#include "model/json.h"
#include "solver/keys/check.h"
#include "solver/keys/one_release.h"
#include "solver/keys/solve.h"
#include "solver/solve.h"

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
    {"local", "fastest XPU for each, scheduled"},
    {"xauto", "XAuto"},
    {"xauto-unscheduled", "XAuto, unscheduled"},
    {"fixed", "fixed priorities"}};

const std::vector<std::string> kOneAtATime = {"ros2", "heft", "xauto", "xauto-unscheduled"};
const std::vector<std::string> kWithRates = {"ros2", "fixed", "xauto"};

std::string name_of(const std::string& id) {
  for (const auto& [known, name] : kPolicyNames)
    if (known == id) return name;
  return id;
}

/// Every XNode on the type that is fastest for it, whatever the others do; among equals the platform's first. How they
/// share its instances, and in which order, is left to the solver: the paper's XAuto "w/o Assign".
std::vector<std::pair<std::string, std::string>> fastest_types(const AppSpec& app,
                                                               const Platform& platform) {
  std::vector<std::pair<std::string, std::string>> pins;
  for (const XNodeSpec& x : app.xnodes) {
    std::string fastest;
    for (const std::string& type : platform.types())
      if (x.wcet_on(type) && (fastest.empty() || *x.wcet_on(type) < *x.wcet_on(fastest)))
        fastest = type;
    pins.emplace_back(x.name, fastest);
  }
  return pins;
}

Result<Policy> solved(const CompareFlags& flags, const std::string& id) {
  if (!flags.spec.hosts.empty())
    return fail(ErrorCode::kInvalid, "it has several hosts, and others' policies know one computer",
                "platform '" + flags.spec.name + "'", "compare on the platform of one host");
  if (id == "fixed") {
    solver::SolveOptions plan;
    plan.time_limit_s = flags.time_limit_s;
    plan.threads = 2;
    return solver::keys::fixed_priorities(flags.app, flags.spec, plan);
  }
  if (id == "heft") {
    solver::SolveOptions plan;
    plan.method = id;
    plan.time_limit_s = flags.time_limit_s;
    XAUTO_ASSIGN(solver::keys::Baseline made, solver::keys::baseline(flags.app, flags.spec, plan));
    return std::move(made.policy);
  }
  solver::keys::Options options;
  options.time_limit_s = flags.time_limit_s;
  options.threads = 2;
  options.aim = solver::keys::usual_aim(flags.app);
  if (id == "local") options.wishes.pins = fastest_types(flags.app, flags.spec);
  XAUTO_ASSIGN(solver::keys::Answer answer, solver::keys::solve(flags.app, flags.spec, options));
  if (answer.outcome != solver::keys::Outcome::kPolicy)
    return fail(ErrorCode::kInfeasible,
                answer.outcome == solver::keys::Outcome::kUnsustainable
                    ? "no policy keeps up: " + answer.overload.text
                    : "no policy was found in this time",
                flags.app.name + " on " + flags.spec.name, "`xauto solve` says more");
  XAUTO_TRY(solver::keys::check(flags.app, flags.spec, answer.policy));
  return std::move(answer.policy);
}

/// `ours`: XAuto's policy, solved once for the runs with and without scheduling.
Result<PolicyRun> prepare(const CompareFlags& flags, const std::string& id,
                          std::optional<Policy>& ours, Outputs& outputs) {
  PolicyRun run;
  run.id = id;
  run.name = name_of(id);
  if (id == "ros2") {
    run.scheduling = runtime::Scheduling::kRos2;
    return run;
  }
  const bool of_xauto = id == "xauto" || id == "xauto-unscheduled";
  if (id == "xauto-unscheduled") run.scheduling = runtime::Scheduling::kTimeshare;
  Policy policy;
  if (of_xauto && ours) {
    policy = *ours;
  } else {
    XAUTO_ASSIGN(policy, solved(flags, id));
    if (of_xauto) ours = policy;
  }
  const std::string path = flags.out + "/" + id + ".policy.json";
  outputs.write(path, to_json(policy, flags.app, flags.spec));
  run.take(std::move(policy));
  XAUTO_TRY(xpu::check_placements(flags.app, flags.spec, flags.presence, *run.policy, path));
  return run;
}

Result<int> compare(const CompareFlags& given, const Options& options) {
  CompareFlags flags = given;
  XAUTO_TRY(flags.prepare());
  if (flags.policies.empty()) flags.policies = flags.app.one_at_a_time ? kOneAtATime : kWithRates;
  std::error_code error;
  std::filesystem::create_directories(flags.out, error);
  if (error) return fail(ErrorCode::kIo, "cannot make the folder: " + error.message(), flags.out);
  Outputs outputs;
  const std::string report_path = flags.out + "/report.json";
  const std::string page_path = flags.out + "/report.html";
  XAUTO_TRY(outputs.expect("--out", report_path));
  XAUTO_TRY(outputs.expect("--out", page_path));

  std::vector<PolicyRun> runs;
  std::vector<story::PagedRun> paged;
  std::optional<Policy> ours;
  bool good = true;
  const StopOnSignal stop;
  for (const std::string& id : flags.policies) {
    XAUTO_ASSIGN(PolicyRun run, prepare(flags, id, ours, outputs));
    const std::string length = flags.seconds > 0 ? fmt::format("{:g} s", flags.seconds)
                                                 : fmt::format("{} activations", flags.activations);
    log::info("{}: running {}", run.name, length);
    XAUTO_TRY(execute(flags, run, stop.flag()));
    good = is_healthy(run) && good;
    const std::string trace_name = id + ".pftrace";
    const Result<std::string> trace = perfetto_of(flags, run);
    if (trace) outputs.write(flags.out + "/" + trace_name, *trace);
    auto page = trace ? paged_of(*trace, trace_name) : tl::unexpected<Error>(trace.error());
    if (page)
      paged.push_back(std::move(*page));
    else
      outputs.failed(page.error());
    runs.push_back(std::move(run));
    if (stop.flag()->load()) break;
  }
  const std::string report = report_json(flags, runs);
  if (options.json)
    std::cout << report;
  else
    std::cout << report_table(flags, runs) << "\n";
  outputs.write(report_path, report);
  outputs.write(page_path, story::page_html(paged));
  if (!options.json && outputs.good())
    std::cout << "  " << report_path << "    the numbers\n  " << page_path
              << "    the picture; open it in a browser\n  " << flags.out
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
      .shown_as(fmt::format("{}; where no source has a rate {}", fmt::join(kWithRates, ","),
                            fmt::join(kOneAtATime, ",")));
  verb.option("--out", flags->out,
              "folder for report.json, report.html, the traces and the policies")
      .shown();
  verb.duration("--time-limit", flags->time_limit_s, Unit::kSeconds, 0.001, kYearS,
                "for the solver, per policy");
}

}  // namespace xauto::cli

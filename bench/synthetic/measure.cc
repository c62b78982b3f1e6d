// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/measure.h"

#include <algorithm>
#include <chrono>

#include "model/json.h"
#include "solver/generate.h"
#include "solver/heft.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "bench/synthetic/emulate.h"
#include "bench/synthetic/time_sharing.h"

namespace xauto::bench {
namespace {

/// Every XNode keeps only its fastest type; the first of the platform among equals.
AppSpec fastest_only(const AppSpec& app, const Platform& platform) {
  AppSpec narrowed = app;
  const std::vector<std::string> types = platform.types();
  for (XNodeSpec& xnode : narrowed.xnodes) {
    std::string fastest;
    for (const std::string& type : types)
      if (const auto us = xnode.wcet_on(type);
          us && (fastest.empty() || *us < *xnode.wcet_on(fastest)))
        fastest = type;
    const std::int64_t us = *xnode.wcet_on(fastest);
    xnode.wcet_us.clear();
    xnode.wcet_us[fastest] = us;
  }
  return narrowed;
}

}  // namespace

Result<AppSpec> workload(int nodes, std::uint64_t seed, const Settings& settings,
                         const Platform& platform) {
  solver::GenerateOptions options;
  options.nodes = nodes;
  options.seed = seed * 1000 + static_cast<std::uint64_t>(nodes);
  options.max_depth = nodes <= 40 ? settings.max_depth : 0;
  options.fork_join = settings.fork_join;
  XAUTO_ASSIGN(AppSpec app, solver::generate(options));
  if (platform.instances_of("dla").empty() && !platform.instances_of("npu").empty())
    for (XNodeSpec& xnode : app.xnodes)
      if (auto dla = xnode.wcet_us.extract("dla"); !dla.empty()) {
        dla.key() = "npu";
        xnode.wcet_us.insert(std::move(dla));
      }
  return app;
}

Result<Measured> measure(const AppSpec& app, const Platform& platform, const Settings& settings) {
  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(app, platform));
  Measured m;
  m.platform = platform.name;
  m.nodes = problem.num_xnodes;
  m.ros2_ideal = share_time(problem, platform, Sharing::kRos2, {}, {.ideal = true}).makespan;
  m.ros2_slices = share_time(problem, platform, Sharing::kRos2, {}).makespan;
  m.heft = solver::simulate(problem, solver::heft(problem)).makespan;

  solver::SolveReport report;
  solver::SolveOptions solving;
  solving.time_limit_s = settings.time_limit_s;
  solving.threads = settings.threads;
  solving.report = &report;
  // From the two texts, as the tool reads them from its files.
  const std::string app_text = to_json(app), platform_text = to_json(platform);
  using Clock = std::chrono::steady_clock;
  const auto began = Clock::now();
  solving.on_progress = [&](const solver::Progress& progress) {
    if (m.first_ms > 0) return;
    m.first_ms = std::chrono::duration<double, std::milli>(Clock::now() - began).count();
    m.first = progress.incumbent;
  };
  XAUTO_ASSIGN(const AppSpec read_app, parse_app(app_text, "app"));
  XAUTO_ASSIGN(const Platform read_platform, parse_platform(platform_text, "platform"));
  XAUTO_ASSIGN(const PriorityPlan policy, solver::solve(read_app, read_platform, solving));
  m.solve_s = std::chrono::duration<double>(Clock::now() - began).count();
  m.xauto = policy.latency_us;
  m.bound = policy.lower_bound_us;
  if (const auto emulated = emulate(app, platform, policy)) m.emulated = emulated->latency_us;
  m.optimal = policy.optimal;
  m.certified = report.ordered ? report.ordered->latency_us : policy.latency_us;
  m.evaluations_per_s = static_cast<double>(report.evaluations) / std::max(m.solve_s, 1e-9);

  solver::Decision decision;
  for (const PriorityPlacement& p : policy.placements) {
    decision.xpu.push_back(p.xpu);
    decision.priority.push_back(p.priority);
  }
  m.unscheduled_ideal =
      share_time(problem, platform, Sharing::kTimeshare, decision, {.ideal = true}).makespan;
  m.unscheduled_slices = share_time(problem, platform, Sharing::kTimeshare, decision).makespan;

  solving.on_progress = nullptr;
  solving.report = nullptr;
  solving.time_limit_s = settings.time_limit_s / 4;
  XAUTO_ASSIGN(const PriorityPlan unassigned,
               solver::solve(fastest_only(app, platform), platform, solving));
  m.unassigned = unassigned.latency_us;
  return m;
}

}  // namespace xauto::bench

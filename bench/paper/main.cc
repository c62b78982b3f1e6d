// SPDX-License-Identifier: Apache-2.0
// bench_paper: what scripts/paper.py cannot ask the tool: the Driving Case under ROS 2's way and ours, for each
// assignment of its inference and as timelines; and brute force beside the solver. Answers in JSON; all of it is
// computed, nothing runs.
#include <chrono>
#include <cstdio>
#include <map>

#include "base/index.h"
#include "cli/cli.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "bench/synthetic/measure.h"
#include "bench/synthetic/time_sharing.h"
#include "brute_force.h"

namespace xauto::bench {
namespace {

struct Flags {
  std::string app = "examples/driving/app.json", platform = "small";
  double time_limit_s = 10;
  int nodes = 5;
  std::uint64_t seed = 1;
};

/// A part of the app with these XNodes on these types alone.
AppSpec narrowed(const AppSpec& app, const std::map<std::string, std::string>& types) {
  AppSpec result = app;
  for (XNodeSpec& x : result.xnodes)
    if (const auto type = types.find(x.name); type != types.end()) {
      const std::int64_t us = x.wcet_us.at(type->second);
      x.wcet_us = {{type->second, us}};
    }
  return result;
}

/// The XNodes that may run on more than one type, in the app's order.
std::vector<std::string> movable(const AppSpec& app) {
  std::vector<std::string> names;
  for (const XNodeSpec& x : app.xnodes)
    if (x.wcet_us.contains("gpu") && x.wcet_us.contains("dla")) names.push_back(x.name);
  return names;
}

Result<PriorityPlan> planned(const AppSpec& app, const Platform& platform, double time_limit_s) {
  solver::SolveOptions options;
  options.time_limit_s = time_limit_s;
  return solver::solve(app, platform, options);
}

solver::Decision decision_of(const PriorityPlan& plan) {
  solver::Decision decision;
  for (const PriorityPlacement& p : plan.placements) {
    decision.xpu.push_back(p.xpu);
    decision.priority.push_back(p.priority);
  }
  decision.order = plan.order;
  return decision;
}

Result<Json> assignments(const Flags& flags) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  const std::vector<std::string> names = movable(app);
  if (names.size() > 10)
    return fail(ErrorCode::kInvalid, "too many XNodes with a choice", flags.app);
  Json rows = Json::array();
  for (std::uint32_t mask = 0; mask < 1U << names.size(); ++mask) {
    std::map<std::string, std::string> types;
    Json on_dla = Json::array();
    for (std::size_t k = 0; k < names.size(); ++k) {
      types[names[k]] = mask >> k & 1U ? "dla" : "gpu";
      if (mask >> k & 1U) on_dla.push_back(names[k]);
    }
    const AppSpec one = narrowed(app, types);
    XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(one, platform));
    XAUTO_ASSIGN(const PriorityPlan plan, planned(one, platform, flags.time_limit_s));
    rows.push_back({{"dla", std::move(on_dla)},
                    {"ros2_us", share_time(problem, platform, Sharing::kRos2, {}).makespan},
                    {"ros2_ideal_us",
                     share_time(problem, platform, Sharing::kRos2, {}, {.ideal = true}).makespan},
                    {"xauto_us", plan.latency_us},
                    {"bound_us", plan.lower_bound_us},
                    {"optimal", plan.optimal}});
  }
  return rows;
}

/// Everything on the GPU: in which order the solver lets the inference begin there, and how long it takes where LD,
/// FCD and RCD must go before TD, as the paper tells of its own solution.
Result<Json> all_on_gpu(const Flags& flags) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  std::map<std::string, std::string> types;
  for (const std::string& name : movable(app)) types[name] = "gpu";
  AppSpec one = narrowed(app, types);
  XAUTO_ASSIGN(const PriorityPlan free, planned(one, platform, flags.time_limit_s));
  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(one, platform));
  const solver::Simulation played = solver::simulate(problem, decision_of(free));
  std::vector<std::pair<std::int64_t, std::string>> begins;
  for (std::size_t i = 0; i < one.xnodes.size(); ++i)
    if (types.contains(one.xnodes[i].name))
      begins.emplace_back(played.start[i], one.xnodes[i].name);
  std::sort(begins.begin(), begins.end());
  Json order = Json::array();
  for (const auto& [us, name] : begins) order.push_back(name);
  const auto index = [&](const std::string& name) {
    for (std::size_t i = 0; i < one.xnodes.size(); ++i)
      if (one.xnodes[i].name == name) return static_cast<int>(i);
    return -1;
  };
  for (const char* first : {"ld.infer", "fcd.infer", "rcd.infer"}) {
    if (index(first) < 0 || index("td.infer") < 0)
      return fail(ErrorCode::kInvalid, std::string("has no XNode ") + first, flags.app);
    one.edges.emplace_back(index(first), index("td.infer"));
  }
  XAUTO_ASSIGN(const PriorityPlan forced, planned(one, platform, flags.time_limit_s));
  return Json{{"xauto_us", free.latency_us},
              {"optimal", free.optimal},
              {"order", std::move(order)},
              {"paper_order_us", forced.latency_us},
              {"paper_order_bound_us", forced.lower_bound_us}};
}

Json timeline(const std::string& title, const AppSpec& app, const Platform& platform,
              const solver::Simulation& played) {
  Json slices = Json::array();
  for (const solver::Slice& s : played.slices)
    slices.push_back({{"xnode", app.xnodes[at(s.xnode)].name},
                      {"module", app.xnodes[at(s.xnode)].module},
                      {"xpu", platform.xpus[at(s.xpu)].type},
                      {"begin_us", s.begin},
                      {"end_us", s.end},
                      {"switching", s.switching}});
  return Json{{"title", title}, {"latency_us", played.makespan}, {"slices", std::move(slices)}};
}

/// The paper's figures 1 and 3: modules under ROS 2, stages with the GPU alone, stages with the DLA, too.
Result<Json> timelines(const Flags& flags) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  std::map<std::string, std::string> types;
  for (const std::string& name : movable(app)) types[name] = "gpu";
  const AppSpec on_gpu = narrowed(app, types);
  solver::SimulateOptions drawn;
  drawn.slices = true;
  XAUTO_ASSIGN(const solver::Problem gpu_problem, solver::Problem::create(on_gpu, platform));
  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(app, platform));
  XAUTO_ASSIGN(const PriorityPlan gpu_plan, planned(on_gpu, platform, flags.time_limit_s));
  XAUTO_ASSIGN(const PriorityPlan plan, planned(app, platform, flags.time_limit_s));
  Json all = Json::array();
  all.push_back(timeline("modules, GPU only, nobody schedules (ROS 2)", app, platform,
                         share_time(gpu_problem, platform, Sharing::kRos2, {}, {.slices = true})));
  all.push_back(timeline("stages, GPU only", app, platform,
                         solver::simulate(gpu_problem, decision_of(gpu_plan), drawn)));
  all.push_back(timeline("stages, GPU and DLA", app, platform,
                         solver::simulate(problem, decision_of(plan), drawn)));
  return all;
}

/// Every assignment and every order that an execution can tell apart, beside the solver on the same DAG.
Result<Json> brute_force(const Flags& flags) {
  using Clock = std::chrono::steady_clock;
  const auto since = [](Clock::time_point began) {
    return std::chrono::duration<double>(Clock::now() - began).count();
  };
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (flags.nodes > solver::test::BruteForce::kMaxNodes)
    return fail(ErrorCode::kInvalid, "brute force is for 24 XNodes at most", "--nodes");
  XAUTO_ASSIGN(const AppSpec app, workload(flags.nodes, flags.seed, {}, platform));
  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(app, platform));
  solver::SolveOptions options;
  options.time_limit_s = flags.time_limit_s;
  options.priorities_only = true;  // as brute force has it
  auto began = Clock::now();
  XAUTO_ASSIGN(const PriorityPlan plan, solver::solve(app, platform, options));
  const double solve_s = since(began);
  began = Clock::now();
  const solver::test::BruteForceAnswer answer = solver::test::brute_force(problem);
  return Json{{"nodes", flags.nodes},        {"seed", flags.seed},
              {"brute_s", since(began)},     {"paths", answer.paths},
              {"brute_us", answer.makespan}, {"solve_s", solve_s},
              {"solve_us", plan.latency_us}, {"optimal", plan.optimal}};
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  using namespace xauto::bench;
  Flags flags;
  std::string what;
  xauto::cli::Program program(
      "Figures of the paper's section 6 that need the solver at hand, as JSON.", "bench_paper");
  program.option("what", what)
      .required()
      .one_of({"assignments", "all-on-gpu", "timelines", "brute-force"});
  program.option("--app", flags.app, "of all but brute-force").shown();
  program.option("--platform", flags.platform).shown();
  program.option("--nodes", flags.nodes, "of brute-force: XNodes").range(1, 24).shown();
  program.option("--seed", flags.seed, "of brute-force: which DAG of that size").shown();
  program.duration("--time-limit", flags.time_limit_s, xauto::cli::Unit::kSeconds, 0.001,
                   xauto::cli::kYearS, "for the solver, each time");
  if (const auto exit = program.parse(argc, argv)) return *exit;
  const auto answer = what == "assignments"  ? assignments(flags)
                      : what == "all-on-gpu" ? all_on_gpu(flags)
                      : what == "timelines"  ? timelines(flags)
                                             : brute_force(flags);
  if (!answer) {
    std::fprintf(stderr, "bench_paper: %s\n", answer.error().to_string().c_str());
    return 1;
  }
  std::printf("%s\n", answer->dump(1).c_str());
  return 0;
}

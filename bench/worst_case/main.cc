// SPDX-License-Identifier: Apache-2.0
// bench_worst_case: tries to break worst_case_us. Policies of the synthetic workload, certified and
// not, on both platforms and on one with non-preemptive XPUs, each attacked with random executions:
// uniform times, corners (0 or WCET), few XNodes gone, all a little early, and a climb around the
// worst so far. Exit status 1 if one execution takes longer than its policy's worst_case_us.
#include <algorithm>
#include <chrono>
#include <cstdio>

#include <fmt/format.h>

#include "cli/cli.h"
#include "model/json.h"
#include "solver/random.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "bench/synthetic/measure.h"

namespace xauto::bench {
namespace {

struct Flags {
  int policies = 504;
  std::int64_t executions = 20'000;
  double time_limit_s = 0.1;
  std::uint64_t seed = 1;
  std::string platform;  ///< empty: small and large, and both without preemption
};

struct Totals {
  std::int64_t executions = 0, above_latency = 0, broken = 0;
  int policies = 0, anomalous = 0, optimal = 0;
  double worst_over_latency = 1, certified_over_latency = 0, nearest = 0;
};

void draw(solver::Random& random, std::uint64_t kind, const std::vector<solver::Time>& wcet,
          const std::vector<solver::Time>& worst, std::vector<solver::Time>& times) {
  for (std::size_t i = 0; i < wcet.size(); ++i) {
    const auto all = static_cast<std::uint64_t>(wcet[i]);
    const auto any = [&] { return static_cast<solver::Time>(random.below(all + 1)); };
    switch (kind) {
      case 0:
        times[i] = any();
        break;
      case 1:
        times[i] = random.below(2) == 0 ? 0 : wcet[i];
        break;
      case 2:
        times[i] = random.below(10) == 0 ? 0 : wcet[i];
        break;
      case 3:
        times[i] = wcet[i] - static_cast<solver::Time>(random.below(all / 5 + 1));
        break;
      default:
        times[i] = random.below(8) == 0 ? any() : worst[i];
    }
  }
}

Status attack(const Flags& flags, int number, Totals& totals) {
  constexpr int kSizes[] = {10, 15, 20, 25, 30, 35, 40};
  Settings settings;
  XAUTO_ASSIGN(Platform platform, load_platform(!flags.platform.empty() ? flags.platform
                                                : number / 7 % 2 == 0   ? "small"
                                                                        : "large"));
  XAUTO_ASSIGN(
      const AppSpec app,
      workload(kSizes[number % 7], 10'000 + flags.seed * 1000 + static_cast<std::uint64_t>(number),
               settings, platform));
  if (flags.platform.empty() && number / 14 % 3 == 2)  // a third: the accelerators cannot preempt
    for (Xpu& xpu : platform.xpus) xpu.preemptive = xpu.type == "cpu";
  solver::SolveOptions solving;
  solving.certify = number / 42 % 2 == 0;
  if (number / 84 % 3 == 2) solving.method = "heft";
  solving.time_limit_s = flags.time_limit_s;
  XAUTO_ASSIGN(const PriorityPlan policy, solver::solve(app, platform, solving));
  if (!policy.worst_case_us)
    return fail(ErrorCode::kInternal, "a policy without worst_case_us", app.name);

  XAUTO_ASSIGN(const solver::Problem problem, solver::Problem::create(app, platform));
  solver::Decision decision;
  std::vector<solver::Time> wcet;
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    decision.xpu.push_back(policy.placements[i].xpu);
    decision.priority.push_back(policy.placements[i].priority);
    wcet.push_back(problem.wcet_on(static_cast<int>(i), policy.placements[i].xpu));
  }
  decision.order = policy.order;
  solver::Random random(flags.seed * 7919 + static_cast<std::uint64_t>(number));
  std::vector<solver::Time> times = wcet, worst = wcet;
  solver::Time longest = solver::simulate(problem, decision).makespan;
  std::int64_t above = 0;
  for (std::int64_t k = 0; k < flags.executions; ++k) {
    draw(random, random.below(5), wcet, worst, times);
    const solver::Time latency = solver::simulate(problem, decision, {.actual = times}).makespan;
    above += latency > policy.latency_us;
    totals.broken += latency > *policy.worst_case_us;
    if (latency >= longest) {
      longest = latency;
      worst = times;
    }
  }
  if (longest > *policy.worst_case_us)
    std::printf("BROKEN: policy %d (%s on %s, method %s): %lld us, certified %lld us\n", number,
                app.name.c_str(), platform.name.c_str(), policy.method.c_str(),
                static_cast<long long>(longest), static_cast<long long>(*policy.worst_case_us));
  const auto latency = static_cast<double>(policy.latency_us);
  totals.executions += flags.executions;
  totals.above_latency += above;
  totals.anomalous += above > 0;
  totals.policies += 1;
  totals.optimal += policy.optimal;
  totals.worst_over_latency =
      std::max(totals.worst_over_latency, static_cast<double>(longest) / latency);
  totals.certified_over_latency += static_cast<double>(*policy.worst_case_us) / latency;
  totals.nearest = std::max(
      totals.nearest, static_cast<double>(longest) / static_cast<double>(*policy.worst_case_us));
  return {};
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program app("Tries to break worst_case_us with random executions.");
  app.option("--policies", flags.policies).shown();
  app.option("--executions", flags.executions, "per policy").shown();
  app.duration("--time-limit", flags.time_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "of the solver, per policy");
  app.option("--seed", flags.seed).shown();
  app.option("--platform", flags.platform, "this one instead of small and large");
  if (const auto exit = app.parse(argc, argv)) return *exit;
  xauto::bench::Totals t[2];  // certified methods, plain ones
  const auto began = std::chrono::steady_clock::now();
  for (int k = 0; k < flags.policies; ++k) {
    const bool certify = k / 42 % 2 == 0 && k / 84 % 3 != 2;
    const auto status = xauto::bench::attack(flags, k, t[certify ? 0 : 1]);
    if (!status) {
      std::fprintf(stderr, "bench_worst_case: %s\n", status.error().to_string().c_str());
      return 2;
    }
  }
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  for (const auto& [name, s] :
       {std::pair{"certified (run-time order)", t[0]}, {"plain fixed priorities", t[1]}})
    if (s.policies > 0)
      std::printf(
          "%-28s %4d policies, %lld executions: %lld above the latency (%d policies, at most %.3f "
          "times), %lld "
          "above worst_case_us; worst_case_us / latency on average %.3f; nearest %.4f of it\n",
          name, s.policies, static_cast<long long>(s.executions),
          static_cast<long long>(s.above_latency), s.anomalous, s.worst_over_latency,
          static_cast<long long>(s.broken), s.certified_over_latency / s.policies, s.nearest);
  std::printf("%.1f s with solving\n", seconds);
  return t[0].broken + t[1].broken > 0 ? 1 : 0;
}

// SPDX-License-Identifier: Apache-2.0
// The registry of methods: one switch from a name to what computes the decision, then the same
// accounting for all: simulate, attach the bound, say whether it is proven, time it.
#include "solver/solve.h"

#include <algorithm>
#include <chrono>

#include <fmt/format.h>

#include "solver/auto.h"
#include "solver/bounds.h"
#include "solver/construct.h"
#include "solver/heft.h"
#include "solver/ilp.h"
#include "solver/ilp_ranges.h"
#include "solver/order.h"
#include "solver/simulate.h"

namespace xauto::solver {
namespace {

// Shares of the time limit. None is tuned: chosen, so that solve() ends as solve.h says.
constexpr double kAtLeastS = 0.2;   ///< beside each share: a small app has an answer at any limit
constexpr double kForStarts = 0.4;  ///< what the search begins with
constexpr double kForMoment = 0.1;  ///< each of what comes after the search
/// Above so many XNodes the clock counts even where evaluations are limited.
constexpr int kHuge = 1000;

bool method_searches(const std::string& method) {
  return method == "auto" || method == "search";
}

/// For what comes after the search: two of these fit into what the limit may be exceeded by. With a
/// budget of evaluations the clock must not decide, so only the huge have one.
Until a_moment(const Problem& problem, const SolveOptions& options) {
  if (options.max_evaluations > 0 && problem.num_xnodes <= kHuge) return {};
  const bool stopped = options.stop != nullptr && options.stop->load();
  const double seconds =
      kAtLeastS + (stopped ? 0 : kForMoment * std::min(options.time_limit_s, kNoLimitS));
  return {std::chrono::steady_clock::now() +
              std::chrono::microseconds(static_cast<std::int64_t>(seconds * 1e6)),
          nullptr};
}

Solution to_solution(const Problem& problem, const Decision& decision) {
  Solution solution;
  solution.xpu = decision.xpu;
  solution.sequence = sequence_of(decision.priority);
  solution.makespan = simulate(problem, decision).makespan;
  return solution;
}

/// HEFT first: no answer of `search` or `auto` is ever worse than it.
std::vector<Solution> starts(const Problem& problem, const Until& until) {
  std::vector<Solution> all = constructive_solutions(problem, until);
  Evaluator evaluator(problem);
  Solution by_heft = to_solution(problem, heft(problem, until));
  gather_groups(problem, by_heft.xpu);
  evaluator.reset(by_heft.xpu, by_heft.sequence);
  by_heft.makespan = evaluator.makespan();
  all.insert(all.begin(), std::move(by_heft));
  const auto shorter = [](const Solution& a, const Solution& b) { return a.makespan < b.makespan; };
  std::stable_sort(all.begin(), all.end(), shorter);
  if (problem.num_xnodes <= kLarge) return all;
  // Large apps: the best of all, then what the race of the search begins with.
  std::vector<Solution> large =
      priced_solutions(problem, composite_bound(problem, 0, until), until);
  constexpr std::size_t kPriced = 6, kOthers = 2;  // chosen
  large.insert(large.begin() + static_cast<std::ptrdiff_t>(std::min(kPriced, large.size())),
               all.begin(), all.begin() + kOthers);
  large.insert(
      large.begin(),
      std::min(all.front(), *std::min_element(large.begin(), large.end(), shorter), shorter));
  return large;
}

constexpr double kForIncumbent = 0.1, kMostForIncumbentS = 2;  ///< of method ilp; chosen

std::string ms(Time us) {
  return fmt::format("{:.3f} ms", static_cast<double>(us) / 1000);
}

/// Who has proven what, after the model.
std::string words_of(const IlpAnswer& answer) {
  if (answer.finished && answer.nodes + answer.by_lp + answer.by_ranges == 0)
    return "optimal before the model: the search's answer meets its own bound";
  const std::string work = fmt::format(
      "{} nodes; lp_solve's {} LPs refuted {} of them and of what was asked at the root, ranges "
      "alone {}",
      answer.nodes, answer.lps, answer.by_lp, answer.by_ranges);
  if (!answer.finished)
    return fmt::format("the paper's model is open after {}: not shorter than {}", work,
                       ms(answer.bound));
  if (answer.proven)
    return fmt::format("the paper's model has nothing shorter than {}: {}", ms(answer.bound), work);
  return fmt::format("the paper's model, which knows no cost of preemption, takes {}: {}",
                     ms(answer.bound), work);
}

/// The model begins with what a short search has. What it leaves open, since it knows neither costs of preemption nor
/// certificates, search and proof of method auto have the rest of the time for.
Result<AutoResult> solve_by_ilp(const Problem& problem, const SolveOptions& options,
                                const std::vector<Solution>& first, TimePoint began) {
  if (problem.num_xnodes > kMostOfModel)
    return fail(ErrorCode::kInvalid,
                "the paper's model is for apps of at most " + std::to_string(kMostOfModel) +
                    " XNodes; this one has " + std::to_string(problem.num_xnodes),
                "method ilp", "take method auto: it proves more, faster");
  const auto left_s = [&] {
    const std::chrono::duration<double> gone = std::chrono::steady_clock::now() - began;
    return std::max(0.0, options.time_limit_s - gone.count());
  };
  SolveOptions part = options;
  // With a budget of evaluations the clock must not decide.
  if (options.max_evaluations == 0)
    part.time_limit_s = std::min(kForIncumbent * options.time_limit_s, kMostForIncumbentS);
  AutoResult result =
      solve_in_parallel(problem, part, first, false, std::chrono::steady_clock::now());
  IlpOptions ilp;
  ilp.time_limit_s = left_s();
  ilp.stop = options.stop;
  ilp.incumbent = to_decision(result.best);
  if (result.best.ordered)
    ilp.incumbent->order = order_pairs(problem, result.best, a_moment(problem, options));
  ilp.known_bound = result.bound;
  XAUTO_ASSIGN(const IlpAnswer answer, solve_ilp(problem, ilp));
  result.bound = std::max(result.bound, answer.bound);
  std::string words = words_of(answer);
  if (answer.makespan < result.best.makespan) result.best = to_solution(problem, *answer.decision);
  const Solution& asked = options.ordered_only ? result.ordered : result.best;
  if (answer.finished && result.bound < asked.makespan && !Until{.stop = options.stop}.over()) {
    part.time_limit_s = options.max_evaluations == 0 ? left_s() : options.time_limit_s;
    const AutoResult more =
        solve_in_parallel(problem, part, {result.best}, true, std::chrono::steady_clock::now());
    result.bound = std::max(result.bound, more.bound);
    result.evaluations += more.evaluations;
    if (more.best.makespan < result.best.makespan) result.best = more.best;
    if (more.ordered.makespan < result.ordered.makespan) result.ordered = more.ordered;
    if (result.bound > answer.bound)
      words += fmt::format("; the proof of method auto: not shorter than {}", ms(result.bound));
  }
  if (options.report != nullptr) options.report->proof = std::move(words);
  return result;
}

}  // namespace

PriorityPlan make_policy(const AppSpec& app, const Platform& platform, const Problem& problem,
                         const Decision& decision, std::string method) {
  const Simulation simulation = simulate(problem, decision);
  PriorityPlan policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = platform.name;
  policy.method = std::move(method);
  policy.order = decision.order;
  policy.latency_us = simulation.makespan;
  policy.placements.resize(app.xnodes.size());
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    policy.placements[i] = {decision.xpu[i], decision.priority[i], simulation.start[i],
                            simulation.finish[i]};
  return policy;
}

Result<PriorityPlan> solve(const AppSpec& app, const Platform& platform,
                           const SolveOptions& options) {
  const auto began = std::chrono::steady_clock::now();
  XAUTO_ASSIGN(Problem problem, Problem::create(app, platform));
  XAUTO_TRY(resolve(options.objectives, app, platform, problem));
  if (options.all_nested_pay) problem.let_all_nested_pay();
  const bool searches = method_searches(options.method);
  if (!searches && (!problem.goal.plain() || !problem.groups.empty()))
    return fail(ErrorCode::kInvalid, "chains and groups need method auto or search",
                "method " + options.method);
  // What the search begins with has a part of its time; a method without search all of it.
  const auto at_most = [&](double share) {
    const double seconds = kAtLeastS + share * std::min(options.time_limit_s, kNoLimitS);
    return Until{began + std::chrono::microseconds(static_cast<std::int64_t>(seconds * 1e6)),
                 options.stop};
  };
  Decision decision;
  Time bound = 0;
  if (options.method == "heft") {
    decision = heft(problem, at_most(1));
    bound = quick_bound(problem, at_most(1));
  } else if (options.method == "local") {
    decision = local(problem, at_most(1));
    bound = quick_bound(problem, at_most(1));
  } else if (searches || options.method == "ilp") {
    const std::vector<Solution> first = starts(problem, at_most(kForStarts));
    AutoResult result;
    if (searches) {
      result = solve_in_parallel(problem, options, first, options.method == "auto", began);
    } else {
      XAUTO_ASSIGN(result, solve_by_ilp(problem, options, first, began));
    }
    const auto decided = [&](const Solution& solution) {
      Decision d = to_decision(solution);
      if (solution.ordered)
        d.order = order_pairs(problem, solution, a_moment(problem, options));
      else if (options.all_nested_pay || !d.order.empty())
        d = order_undisturbed(problem, d);
      return d;
    };
    const Solution& chosen = options.ordered_only ? result.ordered : result.best;
    decision = decided(chosen);
    bound = result.bound;
    if (options.report != nullptr) {
      options.report->evaluations = result.evaluations;
      if (!chosen.ordered && result.ordered.makespan < kNever)
        options.report->ordered =
            make_policy(app, platform, problem, decided(result.ordered), options.method);
    }
  } else {
    return fail(ErrorCode::kInvalid, "unknown method '" + options.method + "'", "solve",
                "one of: auto, search, ilp, heft, local");
  }
  PriorityPlan policy = make_policy(app, platform, problem, decision, options.method);
  policy.lower_bound_us = std::min(bound, policy.latency_us);
  policy.optimal = policy.lower_bound_us == policy.latency_us;
  policy.solve_us = std::chrono::duration_cast<std::chrono::microseconds>(
                        std::chrono::steady_clock::now() - began)
                        .count();
  return policy;
}

}  // namespace xauto::solver

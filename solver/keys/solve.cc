// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/solve.h"

#include <algorithm>
#include <array>
#include <memory>

#include "base/mutex.h"
#include "solver/keys/chains.h"
#include "solver/keys/exhibit.h"
#include "solver/keys/holds.h"
#include "solver/keys/lower_bounds.h"
#include "solver/keys/one_release.h"
#include "solver/keys/search.h"
#include "solver/keys/typical.h"
#include "solver/keys/unpackable.h"
#include "solver/threads.h"

namespace xauto::solver::keys {
namespace {

bool all_equal(const std::vector<std::int64_t>& values) {
  return std::adjacent_find(values.begin(), values.end(), std::not_equal_to<>()) == values.end();
}

// The time of a limit. Its parts are not tuned: chosen.
constexpr double kForFirstBounds = 0.1;  ///< part of the limit, at most
/// For finer bounds at the end: a part of the limit, and at most so many seconds.
constexpr double kForFinerBounds = 0.08, kForFinerBoundsS = 1;
constexpr double kForChains =
    0.5;  ///< part of it: for those of chains, before those of all together
/// Before them, for holds that are not needed; so many seconds at least, even of a limit of 0.
constexpr double kForHolds = 0.05, kForHoldsS = 0.5, kForHoldsAtLeastS = 0.05;
/// Before that, for the least typical latency: a part of the limit, and so many evaluations more as a part of those of
/// the search.
constexpr double kForTypical = 0.1;
/// Beyond the limit, to finish what was begun: a part of it. At least the seconds: even a limit of
/// 0 has an answer where the app is small.
constexpr double kToFinish = 0.1, kToFinishS = 0.2;
/// Cases that are parted, at most, for each chain's bound at the end, and for that of all together.
/// Of all together 60 and 2000 were before; what the number alone brought is not kept.
constexpr int kMostCases = 60, kMostCasesOfAll = 4000;
/// For the plan of one release: a part of the limit, and at most so many seconds; then for the search of keys around
/// it, and for a proof that they are the best. Of a budget so many evaluations of the plan are one of keys.
constexpr double kForPlan = 0.3, kForPlanS = 5, kForPlans = 0.1, kForProof = 0.2;
/// Where one release is all there is: for its plan, and for the search around it so many seconds at most.
constexpr double kForOnlyPlan = 0.7, kAroundOnlyPlanS = 0.3, kToEvaluateS = 1.5;
constexpr std::int64_t kPlansOfEvaluation = 100;
constexpr double kSameBound = 1 + 1e-12;

TimePoint later(TimePoint from, double seconds) {
  return from +
         std::chrono::duration_cast<TimePoint::duration>(std::chrono::duration<double>(seconds));
}

/// Rounded up: what is claimed may be larger, never smaller.
std::int64_t us_above(const Problem& p, Tick t) {
  return t <= 0 ? 0 : p.up_to_us(t) / p.scale;
}

/// Every job at its WCET, by its key, as the holds that are left allow. False: none that repeats was found.
bool predict(const Problem& p, const std::vector<int>& xpu, const Windows& w, Schedule& schedule,
             const Until& until) {
  Rule rule;
  rule.xpu = xpu;
  rule.key = w.d;
  rule.hold = w.hold;
  rule.cost = p.preempt;
  for (int i = 0; i < p.num_xnodes; ++i)
    rule.work.push_back(std::max(Tick{1}, p.wcet(i, xpu[at(i)])));
  rule.window.assign(at(p.num_xnodes), kNoTick);
  rule.delay.assign(at(p.num_xnodes), 0);
  rule.polite.assign(at(p.num_xnodes), 0);
  schedule.start.resize(at(p.num_slots));
  schedule.finish.resize(at(p.num_slots));
  return Exhibitor(p, std::make_shared<Exhibitor::Scratch>()).run(0, rule, schedule, until);
}

Placement placement(const Problem& p, const Candidate& c, bool predicted, int i) {
  Placement placed;
  placed.xpu = c.decision.xpu[at(i)];
  bool held = false;
  for (int n = 0; n < p.jobs[at(i)]; ++n) {
    const std::size_t s = at(p.slot[at(i)] + n);
    placed.key_us.push_back(c.figures.w.d[s] / p.scale);
    placed.hold_us.push_back(c.figures.w.hold[s] / p.scale);
    held = held || placed.hold_us.back() > 0;
    if (!predicted) continue;
    placed.start_us.push_back(c.figures.schedule.start[s] / p.scale);
    placed.finish_us.push_back(c.figures.schedule.finish[s] / p.scale);
  }
  if (!held) placed.hold_us.clear();
  if (all_equal(placed.key_us) && all_equal(placed.hold_us) && all_equal(placed.start_us) &&
      all_equal(placed.finish_us))
    for (auto* values : {&placed.key_us, &placed.hold_us, &placed.start_us, &placed.finish_us})
      if (!values->empty()) values->erase(values->begin() + 1, values->end());
  return placed;
}

Policy policy_of(const AppSpec& app, const Platform& platform, const Problem& p, const Candidate& c,
                 bool predicted, const std::vector<std::int64_t>& bounds) {
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = platform.name;
  policy.method = "auto";
  for (int i = 0; i < p.num_xnodes; ++i) policy.placements.push_back(placement(p, c, predicted, i));
  for (std::size_t k = 0; k < p.chains.size(); ++k) {
    const std::int64_t worst = us_above(p, c.figures.chain[k]);
    policy.chains.push_back({p.chains[k].name, worst, bounds[k], worst == bounds[k]});
    if (app.sources[at(p.chains[k].source)].urgent)
      policy.chains.back().urgent_worst_case_us =
          us_above(p, worst_case(p, p.chains[k], c.figures.w, true));
  }
  return policy;
}

Status check_hint(const Policy& hint, Keep keep, const AppSpec& app, const Problem& p) {
  if (hint.placements.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid, "it places another number of XNodes", "hint",
                "take a policy for this app");
  if (std::all_of(hint.placements.begin(), hint.placements.end(),
                  [](const Placement& placed) { return placed.xpu < 0; }))
    return fail(ErrorCode::kInvalid, "it places none of the app's XNodes on an XPU that is there",
                "hint", "take a policy for this app and platform");
  if (keep != Keep::kPlacement) return {};
  for (int i = 0; i < p.num_xnodes; ++i) {
    const int m = hint.placements[at(i)].xpu;
    const auto& may = p.may_run[at(i)];
    if (!std::binary_search(may.begin(), may.end(), m))
      return fail(ErrorCode::kInvalid, "XNode '" + p.xnode_name[at(i)] + "' cannot run where it is",
                  "hint");
    if (hint.placements[at(i)].key_us.empty())
      return fail(ErrorCode::kInvalid, "XNode '" + p.xnode_name[at(i)] + "' has no key", "hint");
  }
  for (const auto& group : p.groups)
    for (const int i : group)
      if (hint.placements[at(i)].xpu != hint.placements[at(group.front())].xpu)
        return fail(ErrorCode::kInvalid,
                    "XNode '" + p.xnode_name[at(i)] + "' is not with its group", "hint");
  return {};
}

/// The best of all threads, and of each: which of equal ones came first does not matter.
struct Shared {
  Mutex mutex;
  Incumbents best XAUTO_GUARDED_BY(mutex);
  std::vector<Incumbents> of_thread XAUTO_GUARDED_BY(mutex);
  double first_ms XAUTO_GUARDED_BY(mutex) = 0;
};

/// First what limits the others.
void add_all(const std::vector<Incumbents>& from, Incumbents& to) {
  for (const Incumbents& best : from) to.add(best.least());
  for (const Incumbents& best : from) to.add(best.best());
}

/// A policy to begin with, whose order stays.
struct Seed {
  Problem problem;
  Policy policy;
};
struct Seeds {
  std::vector<Seed> seeds;
  /// No policy ends all chains earlier, where all are measured alike; 0: they are not, or it is not known.
  Tick bound = 0;
};

/// The plan of one release, where that is all there is, and a hint with order.
Result<Seeds> seeds_of(const AppSpec& app, const Platform& platform, const Problem& p,
                       const Options& options, double limit_s) {
  Seeds found;
  std::vector<Seed>& seeds = found.seeds;
  if (!options.order) return found;
  const auto add = [&](const Policy& policy) {
    Result<Problem> with = Problem::create(app, platform, options.wishes, policy.order);
    if (with) seeds.push_back({std::move(*with), policy});
  };
  const Policy* hint = options.hint;
  if (hint != nullptr && !hint->order.empty() && check_hint(*hint, Keep::kPlacement, app, p))
    add(*hint);
  if (options.keep != Keep::kNothing) return found;
  SolveOptions asked;
  asked.method = options.method;
  asked.time_limit_s =
      app.one_at_a_time ? kForOnlyPlan * limit_s : std::min(kForPlan * limit_s, kForPlanS);
  asked.threads = options.threads;
  asked.seed = options.seed;
  asked.stop = options.stop;
  asked.objectives = options.wishes;
  if (options.max_evaluations > 0) {
    asked.max_evaluations = options.max_evaluations * kPlansOfEvaluation;
    asked.time_limit_s = limit_s;
  }
  if (app.one_at_a_time && options.on_progress)
    asked.on_progress = [&options](const solver::Progress& at) {
      options.on_progress({.elapsed_s = at.elapsed_s,
                           .release_us = at.certified > 0 ? at.certified : at.incumbent,
                           .release_bound_us = at.bound,
                           .evaluations_per_s = at.evaluations_per_s});
    };
  const Result<ReleasePlan> plan = plan_of_one_release(app, platform, p, std::move(asked));
  if (!plan && options.method != "auto") return tl::unexpected<Error>(plan.error());
  if (plan) {
    add(plan->policy);
    const bool alike = std::all_of(p.chains.begin(), p.chains.end(),
                                   [&](const Chain& c) { return c.by == p.chains.front().by; });
    if (alike) found.bound = plan->bound;
  }
  return found;
}

bool at_bounds(const Problem& p, const Candidate& c, const std::vector<Tick>& bounds) {
  for (std::size_t k = 0; k < bounds.size(); ++k)
    if (c.figures.chain[k] > p.up_to_us(bounds[k])) return false;
  return true;
}

/// All threads' search of one problem.
struct Round {
  const Options& options;
  std::function<double()> elapsed;
  std::int64_t evaluations = 0;  ///< of all searches so far
  double first_ms = 0;

  /// `limits`: of each thread, but for evaluations: those are of all threads.
  Incumbents search(const Problem& p, const std::vector<Tick>& reference, const Policy* hint,
                    Keep keep, const SearchLimits& limits) {
    const std::int64_t budget = limits.max_evaluations;
    const int threads = std::clamp(options.threads, 1, kMostThreads);
    Shared shared{{}, Incumbents(p, reference, options.aim), {}};
    {
      const Lock lock(shared.mutex);
      shared.of_thread.assign(at(threads), shared.best);
      shared.first_ms = first_ms;
    }
    std::vector<std::int64_t> taken(at(threads), 0);
    const auto work = [&](int index) {
      Search search(p, reference, options.aim,
                    options.seed * kSeedsOfRun + static_cast<std::uint64_t>(index));
      SearchLimits own = limits;
      if (budget > 0)
        own.max_evaluations = std::max<std::int64_t>(1, budget / threads);
      else if (threads > 1)  // what depends on who is faster is for those who set no budget
        own.exchange = [&](Incumbents& best) {
          const Lock lock(shared.mutex);
          add_all(shared.of_thread, best);
        };
      search.run(own, hint, keep, [&](const Candidate& c) {
        const Lock lock(shared.mutex);
        if (shared.first_ms == 0) shared.first_ms = elapsed() * 1e3;
        shared.of_thread[at(index)] = search.found();
        const bool better = shared.best.improved_by(c.figures);
        shared.best.add(c);
        if (better && options.on_progress)
          options.on_progress({elapsed(), p.deadlines ? c.figures.largest : 0,
                               c.figures.sum / (p.deadlines ? 1 : static_cast<double>(p.scale)),
                               evaluations + search.evaluations()});
      });
      taken[at(index)] = search.evaluations();
    };
    Threads pool;
    int started = 1;
    while (started < threads && pool.start([&work, started] { work(started); })) ++started;
    work(0);
    // The answer to a budget depends on all of them, wherever they run.
    for (; started < threads && budget > 0; ++started) work(started);
    pool.join();
    for (const std::int64_t e : taken) evaluations += e;
    const Lock lock(shared.mutex);
    first_ms = shared.first_ms;
    Incumbents found(p, reference, options.aim);
    add_all(shared.of_thread, found);
    return found;
  }
};

}  // namespace

Totals totals_of(const AppSpec& app, const std::vector<std::int64_t>& chain_us) {
  const bool deadlines = app.has_deadlines();
  std::int64_t longest = 1;
  for (const ChainSpec& chain : app.chains)
    longest = std::max(longest, chain.deadline_us.value_or(1));
  Totals totals;
  for (std::size_t c = 0; c < app.chains.size() && c < chain_us.size(); ++c) {
    const ChainSpec& chain = app.chains[c];
    const double part =
        static_cast<double>(chain_us[c]) / static_cast<double>(chain.deadline_us.value_or(longest));
    if (!deadlines || chain.deadline_us) totals.largest = std::max(totals.largest, part);
    totals.sum += static_cast<double>(chain.weight) * part;
  }
  return totals;
}

Result<Answer> solve(const AppSpec& app, const Platform& platform, const Options& options) {
  const TimePoint began = std::chrono::steady_clock::now();
  const auto elapsed = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  };
  XAUTO_ASSIGN(Problem p, Problem::create(app, platform, options.wishes));
  if (options.hint != nullptr) XAUTO_TRY(check_hint(*options.hint, options.keep, app, p));
  Answer answer;
  // Releases that wait for each other leave time for any: validate(AppSpec) refuses longer ones.
  if (std::optional<OverloadProof> proof = app.one_at_a_time ? std::nullopt : prove_overload(p)) {
    answer.outcome = Outcome::kUnsustainable;
    answer.overload = std::move(*proof);
    return answer;
  }
  if (options.method != "auto" && !app.one_at_a_time)
    return fail(ErrorCode::kInvalid,
                "plans one release, and the sources of '" + app.name + "' have rates",
                "method " + options.method, "leave it out");
  const double limit = std::clamp(options.time_limit_s, 0.0, kNoLimitS);
  const Until until{
      began + std::chrono::duration_cast<TimePoint::duration>(std::chrono::duration<double>(limit)),
      options.stop};
  Until for_bounds = until;
  for_bounds.deadline =
      std::min(until.deadline, began + std::chrono::duration_cast<TimePoint::duration>(
                                           std::chrono::duration<double>(limit * kForFirstBounds)));
  const std::vector<Tick> reference = lower_bounds(p, app, platform, options.wishes, 0, for_bounds);
  for (const Tick t : reference) answer.lower_bound_us.push_back(us_above(p, t));

  // The last of the time is for finer bounds.
  Until for_search = until, for_finer = until;
  if (limit < kNoLimitS)
    for_search.deadline = std::max(
        for_bounds.deadline,
        began + std::chrono::duration_cast<TimePoint::duration>(std::chrono::duration<double>(
                    limit - std::min(kForFinerBounds * limit, kForFinerBoundsS) -
                    std::min(kForHolds * limit, kForHoldsS))));

  const Until for_typical = for_search;
  if (limit < kNoLimitS && !app.one_at_a_time)
    for_search.deadline =
        std::max(for_bounds.deadline, later(for_search.deadline, -kForTypical * limit));

  Until for_least = until;
  if (limit < kNoLimitS) {
    const TimePoint from = std::min(for_search.deadline, std::chrono::steady_clock::now());
    for_least.deadline = from + std::chrono::duration_cast<TimePoint::duration>(
                                    kForLeast * (for_search.deadline - from));
  }

  Until to_finish = until;
  if (limit < kNoLimitS)
    to_finish.deadline += std::chrono::duration_cast<TimePoint::duration>(
        std::chrono::duration<double>(std::max(kToFinish * limit, kToFinishS)));

  // First the plans of one release, each with its order; then what has none.
  XAUTO_ASSIGN(const Seeds begins, seeds_of(app, platform, p, options, limit));
  const auto& [seeds, bound] = begins;
  const double least_of_all =
      bound == 0 ? 0 : static_cast<double>(bound) / static_cast<double>(p.chains.front().by);
  Round round{options, elapsed};
  std::optional<Incumbents> planned;
  const Seed* seed = nullptr;
  for (const Seed& one : seeds) {
    Until brief = part_of(for_search, kForPlans);
    Until to_evaluate = to_finish;
    if (app.one_at_a_time && limit < kNoLimitS)
      brief.deadline =
          std::min(brief.deadline, later(std::chrono::steady_clock::now(), kAroundOnlyPlanS));
    if (app.one_at_a_time && limit < kNoLimitS && brief.over()) {
      // Its plan took all the time, or somebody stopped it: the plan is what there is, once it is certified.
      brief = {later(std::chrono::steady_clock::now(), kAroundOnlyPlanS)};
      to_evaluate = {later(std::chrono::steady_clock::now(), kToEvaluateS)};
    }
    const std::int64_t budget =
        options.max_evaluations == 0
            ? 0
            : std::max<std::int64_t>(
                  1, static_cast<std::int64_t>(kForPlans *
                                               static_cast<double>(options.max_evaluations)));
    Incumbents with = round.search(one.problem, reference, &one.policy, Keep::kPlacement,
                                   {brief, to_evaluate, budget, brief, {}});
    if (!with.any() || (planned && !planned->improved_by(with.best().figures))) continue;
    planned = std::move(with);
    seed = &one;
  }
  if (options.method != "auto" && !planned) return answer;  // nobody asked for another plan
  // What is proven meanwhile may end it, and does nothing else: a proof's time depends on the machine.
  std::vector<Tick> bounds = reference;
  const auto prove = [&](const Until& in) {
    const std::vector<Tick> finer = lower_bounds(p, app, platform, options.wishes, kMostCases, in);
    for (std::size_t c = 0; c < finer.size(); ++c) bounds[c] = std::max(bounds[c], finer[c]);
  };
  // Of a release that is alone nothing is left to look for where its plan is the shortest.
  const bool shortest =
      planned && app.one_at_a_time && options.aim == Aim::kLargest &&
      (planned->best().figures.largest <= least_of_all * kSameBound || options.method != "auto");
  if (planned && !shortest && limit < kNoLimitS) prove(part_of(for_search, kForProof));
  Incumbents found(p, reference, options.aim);
  if (shortest) {
    // It may be as short with less for the other chains.
    found = *planned;
    if (options.method == "auto" && limit < kNoLimitS) {
      const Until around{
          later(std::chrono::steady_clock::now(), std::min(kAroundOnlyPlanS, kForPlans * limit)),
          options.stop};
      const Policy* from = options.hint != nullptr ? options.hint : &seed->policy;
      Incumbents free = round.search(p, reference, from, Keep::kNothing,
                                     {around, to_finish, options.max_evaluations, around, {}});
      if (free.any() && found.add(free.best())) seed = nullptr;
    }
  } else if (planned && options.keep == Keep::kNothing && at_bounds(p, planned->best(), bounds)) {
    found = *planned;
  } else {
    found = round.search(p, reference, options.hint, options.keep,
                         {for_search, to_finish, options.max_evaluations, for_least, {}});
    // Of equal ones that with order: it waits for jobs, and not for the clock.
    if (planned) {
      const Incumbents free = found;
      found = *planned;
      for (const Candidate* one : {&free.least(), &free.best()})
        if (found.add(*one)) seed = nullptr;
    }
  }
  answer.evaluations = round.evaluations;
  const Problem& of = seed == nullptr ? p : seed->problem;
  Candidate best = found.best();
  if (found.any() && !app.one_at_a_time) {
    SearchLimits last{for_typical, to_finish, options.max_evaluations, {}, {}};
    if (options.max_evaluations > 0)
      last.max_evaluations = std::max<std::int64_t>(
          1, static_cast<std::int64_t>(kForTypical * static_cast<double>(options.max_evaluations)));
    const Keep keep = seed != nullptr ? Keep::kPlacement : options.keep;
    least_typical(app, of, options.seed, keep, last, best);
  }
  if (found.any()) {
    Until for_holds{std::max(for_search.deadline, std::chrono::steady_clock::now())};
    if (limit < kNoLimitS)
      for_holds.deadline +=
          std::chrono::duration_cast<TimePoint::duration>(std::chrono::duration<double>(
              std::clamp(kForHolds * limit, kForHoldsAtLeastS, kForHoldsS)));
    drop_holds(of, best.decision.xpu, best.figures.w, for_holds);
  }
  // What is left of the time makes the bounds better.
  if (shortest && limit < kNoLimitS) for_finer = part_of(for_finer, kForPlans);
  if (p.chains.size() == 1) bounds[0] = std::max(bounds[0], bound);
  if (!found.any() || !at_bounds(p, found.best(), bounds)) prove(part_of(for_finer, kForChains));
  for (std::size_t c = 0; c < bounds.size(); ++c) answer.lower_bound_us[c] = us_above(p, bounds[c]);
  const double unit = p.deadlines ? 1 : static_cast<double>(p.scale);
  // First what was asked for.
  for (const bool sum :
       options.aim == Aim::kLargest ? std::array{false, true} : std::array{true, false})
    (sum ? answer.bounds.sum : answer.bounds.largest) =
        objective_bound(p, bounds, sum, kMostCasesOfAll, for_finer) / unit;
  answer.bounds.largest = std::max(answer.bounds.largest, least_of_all / unit);
  if (!found.any()) {
    if (std::optional<OverloadProof> proof = prove_unpackable(p, kLastLooks, to_finish)) {
      answer.outcome = Outcome::kUnsustainable;
      answer.overload = std::move(*proof);
    }
    return answer;
  }
  answer.outcome = Outcome::kPolicy;
  // Predicted times are those of one schedule; domains that share XPUs have none in common.
  const bool predicted =
      p.domains.size() == 1 && !p.any_urgent &&
      predict(of, best.decision.xpu, best.figures.w, best.figures.schedule, to_finish);
  answer.policy = policy_of(app, platform, of, best, predicted, answer.lower_bound_us);
  if (seed != nullptr) {
    answer.policy.order = seed->policy.order;
    answer.policy.method = seed->policy.method;
  }
  answer.totals = totals_of(app, worst_cases(answer.policy));
  answer.least_largest = std::min(answer.totals.largest, found.least().figures.largest / unit);
  answer.policy.solve_ms = static_cast<std::int64_t>(elapsed() * 1e3);
  answer.first_answer_ms = round.first_ms;
  if (options.hint != nullptr)
    for (int i = 0; i < p.num_xnodes; ++i) {
      const int was = options.hint->placements[at(i)].xpu;
      if (was >= 0 && was != answer.policy.placements[at(i)].xpu) answer.moved.push_back(i);
    }
  return answer;
}

}  // namespace xauto::solver::keys

// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/solve.h"

#include <algorithm>
#include <array>
#include <memory>
#include <optional>

#include "base/mutex.h"
#include "model/contention.h"
#include "model/hosts.h"
#include "solver/keys/chains.h"
#include "solver/keys/contention.h"
#include "solver/keys/exhibit.h"
#include "solver/keys/holds.h"
#include "solver/keys/hosts.h"
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

/// `p` has the WCETs that are counted.
Policy policy_of(const AppSpec& app, const Platform& platform, const Problem& p, const Candidate& c,
                 bool predicted, const std::vector<std::int64_t>& bounds) {
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = platform.name;
  policy.method = "auto";
  for (int i = 0; i < p.num_xnodes; ++i) {
    Placement& placed = policy.placements.emplace_back(placement(p, c, predicted, i));
    if (!stated_loads(app.xnodes[at(i)], platform.xpus[at(placed.xpu)].type).empty())
      placed.wcet_us = p.wcet(i, placed.xpu) / p.scale;
  }
  for (std::size_t k = 0; k < p.chains.size(); ++k) {
    // Not of the figures: without a hold those that nobody asks for may be longer by now.
    const std::int64_t worst = us_above(p, worst_case(p, p.chains[k], c.figures.w));
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
  /// No policy is certified to end all chains earlier, where all are measured alike; 0: they are not, or it is not known.
  Tick bound = 0;
  std::string proof;  ///< Answer::proof
};

/// The plan of one release, where that is all there is, and a hint with order.
Result<Seeds> seeds_of(const AppSpec& app, const Platform& platform, const Problem& p,
                       const Options& options, double limit_s) {
  Seeds found;
  std::vector<Seed>& seeds = found.seeds;
  if (!options.order) return found;
  const auto add = [&](const Policy& policy) {
    Result<Problem> with =
        Problem::create(app, platform, options.wishes, policy.order, options.beside);
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
                           .release_us = at.incumbent,
                           .release_bound_us = at.bound,
                           .evaluations_per_s = at.evaluations_per_s});
    };
  // Bounds are of what XNodes take alone. A plan with the longest times is valid whatever meets.
  std::optional<ReleasePlan> again;
  if (p.contended) {
    asked.time_limit_s /= 2;
    if (auto longest = plan_of_one_release(at_longest(app), platform, p, asked))
      again = std::move(*longest);
  }
  const Result<ReleasePlan> plan = plan_of_one_release(app, platform, p, std::move(asked));
  if (!plan && options.method != "auto") return tl::unexpected<Error>(plan.error());
  if (plan) {
    for (const Policy& policy : plan->policies) add(policy);
    if (again)
      for (const Policy& policy : again->policies) add(policy);
    found.proof = plan->proof;
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

/// What ends when, of the time limit.
struct Times {
  Times(const AppSpec& app, const Options& options, TimePoint began)
      : limit_s(std::clamp(options.time_limit_s, 0.0, kNoLimitS)),
        all{later(began, limit_s), options.stop},
        first_bounds(all),
        search(all),
        typical(all),
        finish(all) {
    first_bounds.deadline = std::min(all.deadline, later(began, limit_s * kForFirstBounds));
    if (!limited()) return;
    // The last of the time is for finer bounds.
    search.deadline =
        std::max(first_bounds.deadline,
                 later(began, limit_s - std::min(kForFinerBounds * limit_s, kForFinerBoundsS) -
                                  std::min(kForHolds * limit_s, kForHoldsS)));
    finish.deadline = later(finish.deadline, std::max(kToFinish * limit_s, kToFinishS));
    typical.deadline = search.deadline;
    if (!app.one_at_a_time)
      search.deadline =
          std::max(first_bounds.deadline, later(search.deadline, -kForTypical * limit_s));
  }
  [[nodiscard]] bool limited() const { return limit_s < kNoLimitS; }
  /// For what limits the other chains, of what is left for the search.
  [[nodiscard]] Until least() const {
    Until until = all;
    if (!limited()) return until;
    const TimePoint from = std::min(search.deadline, std::chrono::steady_clock::now());
    until.deadline = from + std::chrono::duration_cast<TimePoint::duration>(
                                kForLeast * (search.deadline - from));
    return until;
  }
  [[nodiscard]] Until holds() const {
    Until until{std::max(search.deadline, std::chrono::steady_clock::now())};
    if (limited())
      until.deadline =
          later(until.deadline, std::clamp(kForHolds * limit_s, kForHoldsAtLeastS, kForHoldsS));
    return until;
  }

  double limit_s;
  Until all, first_bounds, search, typical, finish;
};

/// One call of `solve`, from the first bounds on.
class Solving {
 public:
  Solving(const AppSpec& app, const Platform& platform, const Options& options, TimePoint began,
          Problem problem)
      : app_(app),
        platform_(platform),
        options_(options),
        began_(began),
        times_(app, options, began),
        p_(std::move(problem)),
        round_{options, [this] { return elapsed_s(); }} {}

  Result<Answer> run() {
    reference_ = lower_bounds(p_, app_, platform_, options_.wishes, 0, times_.first_bounds);
    for (const Tick t : reference_) answer_.lower_bound_us.push_back(us_above(p_, t));
    bounds_ = reference_;
    for_least_ = times_.least();
    // First the plans of one release, each with its order; then what has none.
    XAUTO_ASSIGN(begins_, seeds_of(app_, platform_, p_, options_, times_.limit_s));
    answer_.proof = begins_.proof;
    least_of_all_ = begins_.bound == 0 ? 0
                                       : static_cast<double>(begins_.bound) /
                                             static_cast<double>(p_.chains.front().by);
    for (const Seed& seed : begins_.seeds)
      if (!shortest_of_all()) search_around(seed);
    if (options_.method != "auto" && !planned_)
      return std::move(answer_);  // nobody asked for another plan
    // Of a release that is alone nothing is left to look for where its plan is the shortest. What the paper's model
    // leaves open, since it knows no keys, the search of keys has the rest of the time for.
    const bool shortest = shortest_of_all() || (planned_alone() && options_.method == "search");
    if (planned_ && !shortest && times_.limited()) prove(part_of(times_.search, kForProof));
    const Incumbents found = shortest ? search_around_shortest() : search_all();
    answer_.evaluations = round_.evaluations;
    std::optional<Candidate> best;
    if (found.any()) {
      best = found.best();
      if (!app_.one_at_a_time) make_typical_days_short(*best);
      drop_holds(of(), best->decision.xpu, best->figures.w, times_.holds());
      if (!app_.one_at_a_time)
        reads_all_ = readers_of_all(app_, of(), options_.seed, times_.finish, *best);
    }
    tell_bounds(found, shortest);
    if (found.any())
      tell_policy(*best, found.least());
    else
      tell_unsustainable(prove_unpackable(p_, kLastLooks, times_.finish));
    return std::move(answer_);
  }

 private:
  [[nodiscard]] double elapsed_s() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
  }
  /// What the best has been found of.
  [[nodiscard]] const Problem& of() const { return seed_ == nullptr ? p_ : seed_->problem; }
  /// A tick, as figures have it, in these.
  [[nodiscard]] double unit() const { return p_.deadlines ? 1 : static_cast<double>(p_.scale); }

  /// A release is alone, and has a plan.
  [[nodiscard]] bool planned_alone() const {
    return planned_ && app_.one_at_a_time && options_.aim == Aim::kLargest;
  }
  /// ... and nothing that ends it earlier has a certificate.
  [[nodiscard]] bool shortest_of_all() const {
    return planned_alone() && planned_->best().figures.largest <= least_of_all_ * kSameBound;
  }

  /// For keys that keep its placement and order.
  void search_around(const Seed& seed) {
    Until brief = part_of(times_.search, kForPlans);
    Until to_evaluate = times_.finish;
    if (app_.one_at_a_time && times_.limited()) {
      brief.deadline =
          std::min(brief.deadline, later(std::chrono::steady_clock::now(), kAroundOnlyPlanS));
      if (brief.over()) {
        // Its plan took all the time, or somebody stopped it: the plan is what there is, once it is certified.
        brief = {later(std::chrono::steady_clock::now(), kAroundOnlyPlanS)};
        to_evaluate = {later(std::chrono::steady_clock::now(), kToEvaluateS)};
      }
    }
    const std::int64_t budget =
        options_.max_evaluations == 0
            ? 0
            : std::max<std::int64_t>(
                  1, static_cast<std::int64_t>(kForPlans *
                                               static_cast<double>(options_.max_evaluations)));
    Incumbents with = round_.search(seed.problem, reference_, &seed.policy, Keep::kPlacement,
                                    {brief, to_evaluate, budget, brief, {}});
    if (!with.any() || (planned_ && !planned_->improved_by(with.best().figures))) return;
    planned_ = std::move(with);
    seed_ = &seed;
  }

  /// What is proven meanwhile may end the search, and does nothing else: a proof's time depends on the machine.
  void prove(const Until& until) {
    const std::vector<Tick> finer =
        lower_bounds(p_, app_, platform_, options_.wishes, kMostCases, until);
    for (std::size_t c = 0; c < finer.size(); ++c) bounds_[c] = std::max(bounds_[c], finer[c]);
  }

  /// It may be as short with less for the other chains.
  Incumbents search_around_shortest() {
    Incumbents found = *planned_;
    if (options_.method != "auto" || !times_.limited()) return found;
    const Until around{later(std::chrono::steady_clock::now(),
                             std::min(kAroundOnlyPlanS, kForPlans * times_.limit_s)),
                       options_.stop};
    const Policy* from = options_.hint != nullptr ? options_.hint : &seed_->policy;
    const Incumbents free =
        round_.search(p_, reference_, from, Keep::kNothing,
                      {around, times_.finish, options_.max_evaluations, around, {}});
    if (free.any() && found.add(free.best())) seed_ = nullptr;
    return found;
  }

  Incumbents search_all() {
    if (planned_ && options_.keep == Keep::kNothing && at_bounds(p_, planned_->best(), bounds_))
      return *planned_;
    Incumbents free =
        round_.search(p_, reference_, options_.hint, options_.keep,
                      {times_.search, times_.finish, options_.max_evaluations, for_least_, {}});
    if (!planned_) return free;
    // Of equal ones that with order: it waits for jobs, and not for the clock.
    Incumbents found = *planned_;
    for (const Candidate* one : {&free.least(), &free.best()})
      if (found.add(*one)) seed_ = nullptr;
    return found;
  }

  /// Claims stay as they are.
  void make_typical_days_short(Candidate& best) {
    SearchLimits limits{times_.typical, times_.finish, options_.max_evaluations, {}, {}};
    if (options_.max_evaluations > 0)
      limits.max_evaluations = std::max<std::int64_t>(
          1,
          static_cast<std::int64_t>(kForTypical * static_cast<double>(options_.max_evaluations)));
    const Keep keep = seed_ != nullptr ? Keep::kPlacement : options_.keep;
    least_typical(app_, of(), options_.seed, keep, limits, best);
  }

  /// What is left of the time makes them better.
  void tell_bounds(const Incumbents& found, bool shortest) {
    Until finer = times_.all;
    if (shortest && times_.limited()) finer = part_of(finer, kForPlans);
    if (p_.chains.size() == 1) bounds_[0] = std::max(bounds_[0], begins_.bound);
    if (!found.any() || !at_bounds(p_, found.best(), bounds_)) prove(part_of(finer, kForChains));
    for (std::size_t c = 0; c < bounds_.size(); ++c)
      answer_.lower_bound_us[c] = us_above(p_, bounds_[c]);
    // First what was asked for.
    for (const bool sum :
         options_.aim == Aim::kLargest ? std::array{false, true} : std::array{true, false})
      (sum ? answer_.bounds.sum : answer_.bounds.largest) =
          objective_bound(p_, bounds_, sum, kMostCasesOfAll, finer) / unit();
    answer_.bounds.largest = std::max(answer_.bounds.largest, least_of_all_ / unit());
  }

  void tell_unsustainable(std::optional<OverloadProof> proof) {
    if (!proof) return;
    answer_.outcome = Outcome::kUnsustainable;
    answer_.overload = std::move(*proof);
  }

  /// `least`: of all that were found what has the least of the largest.
  void tell_policy(Candidate& best, const Candidate& least) {
    answer_.outcome = Outcome::kPolicy;
    std::optional<Problem> with_counted;  // a large one is copied only where that matters
    if (p_.contended) {
      with_counted = of();
      count_wcets(*with_counted, best.decision.xpu,
                  counted_wcets(of(), best.decision.xpu, best.figures.w));
    }
    const Problem& counted = with_counted ? *with_counted : of();
    // Predicted times are those of one schedule; domains that share XPUs have none in common.
    const bool predicted =
        p_.domains.size() == 1 && !p_.any_urgent && options_.beside.demands.empty() &&
        predict(counted, best.decision.xpu, best.figures.w, best.figures.schedule, times_.finish);
    answer_.policy = policy_of(app_, platform_, counted, best, predicted, answer_.lower_bound_us);
    for (std::size_t i = 0; i < reads_all_.size(); ++i)
      answer_.policy.placements[i].reads_all = reads_all_[i] != 0;
    if (seed_ != nullptr) {
      answer_.policy.order = seed_->policy.order;
      answer_.policy.method = seed_->policy.method;
    }
    answer_.totals = totals_of(app_, worst_cases(answer_.policy));
    answer_.least_largest = std::min(answer_.totals.largest, least.figures.largest / unit());
    answer_.policy.solve_us = static_cast<std::int64_t>(elapsed_s() * 1e6);
    answer_.first_answer_ms = round_.first_ms;
    for (int i = 0; options_.hint != nullptr && i < p_.num_xnodes; ++i) {
      const int was = options_.hint->placements[at(i)].xpu;
      if (was >= 0 && was != answer_.policy.placements[at(i)].xpu) answer_.moved.push_back(i);
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Options& options_;
  const TimePoint began_;
  const Times times_;
  const Problem p_;
  Round round_;
  std::vector<Tick> reference_, bounds_;  ///< [chain] at first; by now
  Until for_least_;
  Seeds begins_;
  double least_of_all_ = 0;  ///< no policy has less for its largest
  std::optional<Incumbents> planned_;
  std::vector<char> reads_all_;  ///< [xnode] of the best; empty: of none
  const Seed* seed_ = nullptr;   ///< of begins_, whose order the best has; null: it has none
  Answer answer_;
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
  XAUTO_TRY(validate_pins(app, platform));
  if (!platform.hosts.empty() && !options.spread) return solve_on_hosts(app, platform, options);
  const TimePoint began = std::chrono::steady_clock::now();
  XAUTO_ASSIGN(Problem p, Problem::create(app, platform, options.wishes, {}, options.beside));
  if (options.hint != nullptr) XAUTO_TRY(check_hint(*options.hint, options.keep, app, p));
  // Releases that wait for each other leave time for any: validate(AppSpec) refuses longer ones.
  if (std::optional<OverloadProof> proof = app.one_at_a_time ? std::nullopt : prove_overload(p)) {
    Answer answer;
    answer.outcome = Outcome::kUnsustainable;
    answer.overload = std::move(*proof);
    return answer;
  }
  if (options.method != "auto" && !app.one_at_a_time)
    return fail(ErrorCode::kInvalid,
                "plans one release, and the sources of '" + app.name + "' have rates",
                "method " + options.method, "leave it out");
  return Solving(app, platform, options, began, std::move(p)).run();
}

}  // namespace xauto::solver::keys

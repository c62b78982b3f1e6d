// SPDX-License-Identifier: Apache-2.0
// See auto.h.
#include "solver/auto.h"

#include <algorithm>
#include <condition_variable>
#include <optional>
#include <utility>

#include "base/mutex.h"
#include "solver/bounds.h"
#include "solver/composite.h"
#include "solver/exact.h"
#include "solver/ordered.h"
#include "solver/random.h"
#include "solver/stretches.h"
#include "solver/tabu.h"
#include "solver/threads.h"

namespace xauto::solver {
namespace {

using Clock = std::chrono::steady_clock;

// ---- constants of the team ----------------------------------------------------------------------
// Where nothing more is said, a value is not tuned: it was chosen when what it belongs to was
// written, and no measurement of its neighbours is kept.

/// Starts that race on each thread; each round of the race has one of so many parts of the limit.
constexpr std::size_t kRunners = 4;
constexpr int kPartsPerRound = 9;

// Turns of a space: short at first, so that each has had one early, then longer and longer.
/// Seconds of the first turn, at most, and in how many parts of a short limit.
constexpr double kFirstTurnS = 0.05, kFirstTurns = 40;
/// With a budget: in so many parts of it, and at most so many evaluations.
constexpr std::int64_t kFirstShares = 6, kMostOfFirstShare = 20'000;
constexpr int kTurnGrows = 4;   ///< by a part of so many
constexpr int kTurnsAlone = 4;  ///< until a worker goes on from the team's best

/// Parts of the limit, of which a large app's bounds have one.
constexpr double kPartsPerBound = 3;
constexpr auto kReportEvery = std::chrono::milliseconds(100);
constexpr double kLeastElapsedS = 1e-9;  ///< that a speed is divided by

/// Seeds of one thread lie within so many of each other, and so do those of a round of the race,
/// which has its own.
constexpr std::uint64_t kSeedsOfThread = 7919, kSeedsOfRound = 31, kSeedsOfRace = 500;

Clock::duration seconds(double s) {
  return std::chrono::duration_cast<Clock::duration>(
      std::chrono::duration<double>(std::max(0.0, s)));
}

class Team {
 public:
  Team(const Problem& problem, const SolveOptions& options, const std::vector<Solution>& starts,
       bool with_proof, TimePoint began)
      : problem_(problem),
        options_(options),
        starts_(starts),
        undisturbed_(problem),
        with_proof_(with_proof),
        threads_(std::clamp(options.threads, 1, kMostThreads)),
        began_(began),
        deadline_(options.time_limit_s >= kNoLimitS ? TimePoint::max()
                                                    : began + seconds(options.time_limit_s)) {
    for (std::size_t x = 0; x < problem.preemptive.size(); ++x) {
      some_preempt_ = some_preempt_ || problem.preemptive[x];
      some_pay_ =
          some_pay_ || !problem.preemptive[x] || problem.preempt[x] > 0 || problem.levels[x] > 0;
      undisturbed_.preemptive[x] = 0;
    }
    rounds_ = rounds();
    OrderedEvaluator evaluator(problem);
    evaluator.reset(starts.front().xpu, starts.front().sequence);
    all_.best = starts.front();
    all_.ordered = {evaluator.xpu(), evaluator.sequence(), evaluator.makespan(), true};
    found_.resize(static_cast<std::size_t>(threads_));
    if (options.priorities_only) all_.ordered.makespan = kNever;
    incumbent_.store(std::min(all_.best.makespan, all_.ordered.makespan));
    ordered_best_.store(all_.ordered.makespan);
    // The first answer is out before anything that takes longer begins.
    report();
    const Until until{deadline_, options.stop};
    bound_.store(quick_bound(problem, until));
    if (large() && counted()) raise_bound(composite_bound(problem, 1, until).bound);
  }

  AutoResult run() {
    Threads workers;
    {
      const Lock lock(mutex_);
      running_ = threads_;
    }
    const auto run = [this](int t) {
      const Ends ends{*this};
      work(t);
    };
    int started = 0;
    while (started < threads_ && workers.start([run, started] { run(started); })) ++started;
    // Without that many threads: the last one has the proof, and the answer to a budget needs all.
    for (int t = started; t < threads_; ++t) {
      if (counted() || t == threads_ - 1)
        run(t);
      else
        const Ends ends{*this};
    }
    report_until_done();
    workers.join();
    // With a budget the proof comes last, and with a budget of its own.
    if (counted() && with_proof_ && !met() && problem_.num_xnodes <= kMostToProve) prove();
    const Lock lock(mutex_);
    for (const Found& found : found_) {
      if (found.ordered.makespan < kNever) merge(all_, found.ordered, true);
      if (found.best.makespan < kNever) merge(all_, found.best, found.best.ordered);
    }
    if (large() && !options_.priorities_only && !all_.best.ordered)
      merge(all_, in_order(all_.best), true);
    AutoResult result;
    result.best = all_.best;
    result.ordered = all_.ordered;
    // A schedule that keeps its order is worth more than one of the same latency that does not.
    if (all_.ordered.makespan <= all_.best.makespan + worth_of_order()) result.best = all_.ordered;
    result.bound = std::min(bound_.load(), result.best.makespan);
    result.evaluations = evaluations_.load();
    return result;
  }

 private:
  /// One of `running_`, which ends however its work does.
  struct Ends {
    Team& of;
    ~Ends() {
      const Lock lock(of.mutex_);
      --of.running_;
      of.changed_.notify_all();
    }
  };
  struct Found {
    Solution best, ordered;
  };

  /// With an evaluation budget, a worker must not depend on how fast the others are.
  [[nodiscard]] bool counted() const { return options_.max_evaluations > 0; }

  /// By how much a schedule that keeps its order may be longer than one that does not and still be
  /// preferred. Without order the worst case of a large app is many times its latency.
  [[nodiscard]] Time worth_of_order() const XAUTO_REQUIRES(mutex_) {
    constexpr Time kShare = 100;
    if (!large() || !problem_.goal.plain()) return 0;
    // Never longer than the first answer, which has been reported.
    return std::min(all_.best.makespan / kShare,
                    std::max<Time>(0, starts_.front().makespan - all_.best.makespan));
  }

  StopWhen stop_when(const Clock::duration slice, std::int64_t budget, int effort) const {
    StopWhen when;
    when.deadline = counted() ? deadline_ : std::min(deadline_, Clock::now() + slice);
    when.max_evaluations = budget;
    when.stop = options_.stop;
    when.stop_too = counted() ? nullptr : &done_;
    when.target = counted() ? nullptr : &bound_;
    when.effort = effort;
    return when;
  }

  [[nodiscard]] bool over() const {
    return (options_.stop != nullptr && options_.stop->load()) || Clock::now() >= deadline_ ||
           (!counted() && done_.load());
  }

  /// kDispatched: priorities on XPUs that do not preempt, kept as the order that this gives. kTabu,
  /// kStretches: order on every XPU as kOrdered, searched in other ways.
  enum class Space { kPriorities, kOrdered, kTabu, kStretches, kDispatched, kMixed };

  /// Whose turn it is. Where preemption is free everywhere, priorities alone reach what any policy
  /// reaches; where it is possible nowhere, they are dispatched as they are, and order alone does.
  [[nodiscard]] Space space_of(int turn) const {
    return rounds_[static_cast<std::size_t>(turn) % rounds_.size()];
  }

  [[nodiscard]] std::vector<Space> rounds() const {
    constexpr auto kPriorities = Space::kPriorities, kOrdered = Space::kOrdered;
    constexpr auto kDispatched = Space::kDispatched, kMixed = Space::kMixed;
    constexpr auto kStretches = Space::kStretches;
    const Space order = TabuSearch::serves(problem_) ? Space::kTabu : kOrdered;
    if (options_.priorities_only) return {kPriorities};
    if (options_.ordered_only && stretches()) return {kStretches, order, kStretches, kOrdered};
    if (options_.ordered_only) return {order, kOrdered};
    // Of any size: with a quarter of the turns, Brandimarte's job shops ended 0.2 % longer.
    if (!some_preempt_) return {order, kPriorities, order, order, kOrdered, order};
    const bool mixing = some_preempt_ && some_pay_;
    if (large()) {
      const Space last = mixing ? kMixed : kPriorities;
      if (stretches())
        return {kStretches, kPriorities, kStretches, kOrdered, kStretches, order, kStretches, last};
      return {order, kPriorities, kPriorities, kOrdered, order, kPriorities, last, kOrdered};
    }
    if (!mixing) return {kPriorities, kOrdered, order, kDispatched};
    // Tabu search finds nothing here that these do not, and each of them has to have its turns.
    return {kPriorities, kOrdered, kDispatched, kMixed};
  }
  [[nodiscard]] int round_length() const { return static_cast<int>(rounds_.size()); }

  /// An order that takes no longer than `solution` does where nothing preempts.
  [[nodiscard]] Solution in_order(const Solution& solution) const {
    Evaluator evaluator(undisturbed_);
    evaluator.reset(solution.xpu, solution.sequence);
    std::vector<int> sequence = solution.sequence;
    std::stable_sort(sequence.begin(), sequence.end(),
                     [&](int a, int b) { return evaluator.start(a) < evaluator.start(b); });
    OrderedEvaluator ordered(problem_);
    ordered.reset(solution.xpu, sequence);
    return {ordered.xpu(), ordered.sequence(), ordered.makespan(), true, {}};
  }

  [[nodiscard]] bool large() const { return problem_.num_xnodes > kLarge; }
  [[nodiscard]] bool stretches() const {
    return large() && !options_.priorities_only && stretches_serve(problem_);
  }

  [[nodiscard]] std::uint64_t seed_of(int t, std::uint64_t of_thread) const {
    return options_.seed * kSeedsOfRun + static_cast<std::uint64_t>(t) * kSeedsOfThread + of_thread;
  }

  /// A few starts get a little time each, the better half of them more, until one is left.
  Solution race(int t, std::int64_t& budget) {
    std::vector<Solution> runners;
    for (std::size_t k = 0; k < kRunners; ++k) {
      const std::size_t from =
          1 + k * static_cast<std::size_t>(threads_) + static_cast<std::size_t>(t);
      if (from < starts_.size()) runners.push_back(starts_[from]);
    }
    if (runners.empty()) return starts_.front();
    SearchCallbacks callbacks;
    std::int64_t used = 0;
    callbacks.on_evaluations = [&](std::int64_t count) {
      used += count;
      evaluations_.fetch_add(count, std::memory_order_relaxed);
    };
    const bool ordered = stretches();
    callbacks.on_better = [&](const Solution& solution) { note(t, solution, ordered); };
    if (ordered)
      for (Solution& runner : runners) runner = in_order(runner);
    const std::int64_t level = budget / kPartsPerRound;
    for (int round = 0; runners.size() > 1 && !over(); ++round) {
      const double each =
          options_.time_limit_s / kPartsPerRound / static_cast<double>(runners.size());
      for (std::size_t k = 0; k < runners.size() && !over(); ++k) {
        const StopWhen mine =
            stop_when(seconds(each), level / static_cast<std::int64_t>(runners.size()) + 1, 0);
        const std::uint64_t seed =
            seed_of(t, kSeedsOfRace + static_cast<std::uint64_t>(round) * kSeedsOfRound + k);
        runners[k] = ordered ? anneal_stretches(problem_, runners[k], seed, mine, callbacks)
                             : anneal(problem_, runners[k], seed, mine, callbacks);
      }
      std::stable_sort(runners.begin(), runners.end(), [](const Solution& a, const Solution& b) {
        return a.makespan < b.makespan;
      });
      runners.resize((runners.size() + 1) / 2);
    }
    if (counted()) budget -= used;
    return runners.front();
  }

  /// A worker's own best: by priorities, in an order, and with both.
  struct Held {
    int thread;
    Solution own, ordered, mixed;
    std::optional<TabuSearch> tabu;
  };

  /// Searches one space, from the best start that it can have.
  void take_turn(Space space, Held& held, std::uint64_t seed, const StopWhen& mine,
                 SearchCallbacks& callbacks) {
    switch (space) {
      case Space::kPriorities:
        held.own = anneal(problem_, held.own, seed, mine, callbacks);
        break;
      case Space::kOrdered: {
        const Solution& start =
            held.ordered.makespan <= held.own.makespan ? held.ordered : held.own;
        held.ordered = anneal_ordered(problem_, start, seed, mine, callbacks);
        break;
      }
      case Space::kTabu:
      case Space::kStretches: {
        if (space == Space::kTabu && !held.tabu) held.tabu.emplace(problem_, seed);
        const Solution start =
            held.own.makespan < held.ordered.makespan ? in_order(held.own) : held.ordered;
        Solution found = space == Space::kTabu
                             ? held.tabu->run(start, mine, callbacks)
                             : anneal_stretches(problem_, start, seed, mine, callbacks);
        if (found.makespan < held.ordered.makespan) held.ordered = std::move(found);
        break;
      }
      case Space::kDispatched: {
        const Solution start = held.ordered.makespan <= held.own.makespan ? held.ordered : held.own;
        callbacks.on_better = [&](const Solution& solution) {
          Solution ordered = in_order(solution);
          if (ordered.makespan >= held.ordered.makespan) return;
          note(held.thread, ordered, true);
          held.ordered = std::move(ordered);
        };
        (void)anneal(undisturbed_, start, seed, mine, callbacks);
        break;
      }
      case Space::kMixed: {
        const Solution* start = &held.own;
        if (held.mixed.makespan < start->makespan) start = &held.mixed;
        if (held.ordered.makespan < start->makespan) start = &held.ordered;
        held.mixed = anneal_mixed(problem_, start->ordered ? as_waiting(*start) : *start, seed,
                                  mine, callbacks);
        break;
      }
    }
  }

  void work(int t) {
    const auto k = static_cast<std::size_t>(t);
    Held held{t, starts_[k % starts_.size()], {}, {}, {}};
    Solution &own = held.own, &own_ordered = held.ordered, &own_mixed = held.mixed;
    own_ordered = own_mixed = own;
    own_ordered.makespan = own_mixed.makespan = kNever;
    std::int64_t budget = options_.max_evaluations / threads_ + (counted() ? 1 : 0);
    Clock::duration slice = seconds(std::min(kFirstTurnS, options_.time_limit_s / kFirstTurns));
    // All spaces have a turn, however small the budget.
    std::int64_t share = std::clamp<std::int64_t>(budget / kFirstShares, 1, kMostOfFirstShare);
    // The last worker proves, once the search had its first turns.
    const bool proves =
        with_proof_ && !counted() && t == threads_ - 1 && problem_.num_xnodes <= kMostToProve;
    // The bound of a large app takes a few tenths of a second, of a huge one as much as it may:
    // one worker begins with it.
    if (large() && !counted() && t == threads_ - 1) {
      const Until until{
          std::min(deadline_, Clock::now() + seconds(options_.time_limit_s / kPartsPerBound)),
          options_.stop};
      raise_bound(composite_bound(problem_, 1, until).bound);
    }
    if (large() && some_preempt_ && !options_.ordered_only) {
      own = race(t, budget);
      if (own.ordered) own_ordered = std::exchange(own, by_finish(problem_, own));
    }
    if (counted() && budget <= 0) return;
    for (int turn = 0; !over(); ++turn) {
      std::int64_t used = 0;
      SearchCallbacks callbacks;
      callbacks.on_evaluations = [&](std::int64_t count) {
        used += count;
        evaluations_.fetch_add(count, std::memory_order_relaxed);
      };
      const Space space = space_of(turn);
      callbacks.on_better = [&](const Solution& solution) {
        note(t, solution,
             space == Space::kOrdered || space == Space::kTabu || space == Space::kStretches);
      };
      const StopWhen mine =
          stop_when(slice, counted() ? std::min(budget, share) : 0, turn / round_length());
      const std::uint64_t seed = seed_of(t, static_cast<std::uint64_t>(turn));
      take_turn(space, held, seed, mine, callbacks);
      if (own_ordered.makespan < own.makespan) {
        // What one space has found is a start in the other.
        Solution shared = by_finish(problem_, own_ordered);
        if (shared.makespan < own.makespan) {
          note(t, shared, false);
          own = std::move(shared);
        }
      }
      if (counted()) {
        budget -= std::max<std::int64_t>(used, 1);
        share += share / kTurnGrows;
        if (budget <= 0) return;
        continue;
      }
      slice += slice / kTurnGrows;
      if (met()) done_.store(true);
      // Again after an exhausted proof only below a better incumbent.
      if (proves && turn >= round_length() - 1 && incumbent_.load() < proof_ended_at_) {
        prove();
        if (over()) return;
        if (large()) proof_ended_at_ = 0;
      }
      if (turn % kTurnsAlone == kTurnsAlone - 1) take_over(own, own_ordered, own_mixed);
    }
  }

  void prove() {
    ProofControl control;
    control.known_bound = bound_.load();
    control.deadline = deadline_;
    // What the root alone gives comes early; the search needs the thread more.
    if (large() && !counted())
      control.deadline =
          std::min(deadline_, Clock::now() + seconds(options_.time_limit_s / kPartsPerBound));
    control.stop = options_.stop;
    control.stop_too = &done_;
    if (counted()) control.max_lps = options_.max_evaluations / kEvaluationsPerLp + 1;
    control.incumbent = &incumbent_;
    control.on_bound = [&](Time bound) {
      raise_bound(bound);
      if (met()) done_.store(true);
    };
    control.on_solution = [&](const Solution& solution) {
      if (options_.priorities_only && !solution.waits_for.empty()) return;
      note(threads_ - 1, solution, false);
    };
    control.on_bound(prove_bound(problem_, control));
    proof_ended_at_ = incumbent_.load();
  }

  [[nodiscard]] bool met() const {
    if (options_.ordered_only) return ordered_best_.load() <= bound_.load();
    return incumbent_.load() <= bound_.load();
  }

  void raise_bound(Time bound) {
    Time known = bound_.load();
    while (bound > known && !bound_.compare_exchange_weak(known, bound)) {
    }
  }

  /// With a budget each worker keeps its own best, and the end merges them in their order: which of
  /// two equals came first must not matter.
  void note(int t, const Solution& solution, bool ordered) {
    const Lock lock(mutex_);
    if (counted())
      merge(found_[static_cast<std::size_t>(t)], solution, ordered);
    else
      merge(all_, solution, ordered);
    if (ordered) lower(ordered_best_, solution.makespan);
    lower(incumbent_, solution.makespan);
  }

  static void merge(Found& found, const Solution& solution, bool ordered) {
    if (ordered && solution.makespan < found.ordered.makespan) {
      found.ordered = solution;
      found.ordered.ordered = true;
    }
    if (solution.makespan < found.best.makespan) {
      found.best = solution;
      found.best.ordered = ordered;
    }
  }

  static void lower(std::atomic<Time>& value, Time to) {
    Time known = value.load();
    while (to < known && !value.compare_exchange_weak(known, to)) {
    }
  }

  /// Workers that fell behind go on from the team's best.
  void take_over(Solution& own, Solution& own_ordered, Solution& own_mixed) {
    const Lock lock(mutex_);
    if (!all_.best.ordered) {
      Solution& mine = all_.best.waits_for.empty() ? own : own_mixed;
      if (all_.best.makespan < mine.makespan) mine = all_.best;
    }
    if (all_.ordered.makespan < own_ordered.makespan) own_ordered = all_.ordered;
  }

  void report() const {
    if (!options_.on_progress) return;
    Progress progress;
    progress.elapsed_s = std::chrono::duration<double>(Clock::now() - began_).count();
    progress.incumbent = incumbent_.load();
    progress.bound = std::min(bound_.load(), progress.incumbent);
    progress.ordered = ordered_best_.load();
    if (progress.incumbent > 0)
      progress.gap = static_cast<double>(progress.incumbent - progress.bound) /
                     static_cast<double>(progress.incumbent);
    progress.evaluations_per_s =
        static_cast<double>(evaluations_.load()) / std::max(kLeastElapsedS, progress.elapsed_s);
    options_.on_progress(progress);
  }

  void report_until_done() {
    Lock lock(mutex_);
    while (running_ > 0) {
      changed_.wait_for(lock, kReportEvery);
      if (!options_.on_progress || running_ == 0) continue;
      lock.unlock();
      report();
      lock.lock();
    }
  }

  const Problem& problem_;
  const SolveOptions& options_;
  const std::vector<Solution>& starts_;
  Problem undisturbed_;  // the same, but nothing preempts
  bool some_preempt_ = false, some_pay_ = false;
  std::vector<Space> rounds_;
  const bool with_proof_;
  const int threads_;
  const TimePoint began_, deadline_;

  Mutex mutex_;
  std::condition_variable_any changed_;
  Found all_ XAUTO_GUARDED_BY(mutex_);  // the team's best
  std::vector<Found> found_
      XAUTO_GUARDED_BY(mutex_);  // with a budget: each worker's, merged at the end
  int running_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::atomic<Time> incumbent_{kNever}, ordered_best_{kNever}, bound_{0};
  std::atomic<std::int64_t> evaluations_{0};
  std::atomic<bool> done_{false};
  Time proof_ended_at_ = kNever;  // the incumbent of the last proof; only the proving worker
};

}  // namespace

AutoResult solve_in_parallel(const Problem& problem, const SolveOptions& options,
                             const std::vector<Solution>& starts, bool with_proof,
                             TimePoint began) {
  return Team(problem, options, starts, with_proof, began).run();
}

}  // namespace xauto::solver

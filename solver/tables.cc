// SPDX-License-Identifier: Apache-2.0
// See tables.h.
#include "solver/tables.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <set>
#include <tuple>

#include "base/index.h"
#include "solver/keys/key_tables.h"
#include "solver/keys/one_release.h"
#include "solver/keys/sequence.h"
#include "solver/least_loss.h"
#include "solver/order.h"
#include "solver/ordered.h"
#include "solver/random.h"
#include "solver/solve.h"
#include "solver/tables_run.h"

namespace xauto::solver {
namespace {

// ---- constants of the search --------------------------------------------------------------------
// None is tuned: each was chosen when what it belongs to was written, and no measurement of its
// neighbours is kept. `bench_tables` shows what a change does.

/// Where evaluations are counted, so many rounds end the search: speed then says nothing.
constexpr int kTableRounds = 24;
/// Searches for the least loss that a scenario's share is divided by.
constexpr double kLossTries = 8;
/// Seconds of a search at least; of one that anneals a table at most.
constexpr double kLeastSearchS = 0.02, kMostSearchS = 0.4;
/// Temperatures of a table's annealing, as shares of the largest makespan / bound: first, least, by
/// which factor they fall at each look at the clock, and how much of them a move may use.
constexpr double kTableHot = 0.02, kTableCold = 1e-5, kTableCools = 0.999, kHeatCounts = 0.5;
constexpr std::int64_t kTableMovesPerLook = 64, kMovesPerHeating = 16'384;
/// Of its moves, one in so many goes to another XPU; the rest in the sequence, half of them by so
/// many places at most.
constexpr std::uint64_t kOneInMoves = 3;
constexpr int kNearby = 4;
/// Of those to another XPU, one in so many exchanges the XPUs of two XNodes.
constexpr std::uint64_t kOneExchanges = 2;
/// Every table is tried where they are at most so many, each under each scenario, of so few XNodes; and
/// where of those that are best under something at most so many are left.
constexpr double kMostTried = 300'000;
constexpr std::size_t kMostOrdered = 10, kMostBest = 300;

struct TableCandidate {
  std::vector<int> xpu, sequence;  ///< of what its loss leaves
  std::vector<double> regret;      ///< [scenario]
  int loss = 0;                    ///< index into TablesSearch::lossy_
};

/// The app without what one loss takes, under all scenarios.
struct Lossy {
  Loss loss;
  std::vector<int> kept;          ///< [XNode of the problems] index into the app's
  std::vector<Problem> problems;  ///< [scenario] on the whole platform, what is lost forbidden
};

class TablesSearch {
 public:
  TablesSearch(const AppSpec& app, const Platform& platform, const Scenarios& scenarios,
               const TablesOptions& options)
      : app_(app),
        platform_(platform),
        scenarios_(scenarios.list),
        options_(options),
        run_(options, scenarios.list.size()),
        random_(options.seed) {}

  Result<Tables> run() {
    XAUTO_TRY(solve_each());
    const bool all = lossy_.size() == 1 && try_all();
    if (options_.tried_all != nullptr) *options_.tried_all = all;
    TableChoice best = choose();
    for (int round = 0; (options_.max_evaluations == 0 || round < kTableRounds) && !run_.over();
         ++round) {
      if (all || best.worst == kCannotServe || best.worst <= run_.goal()) break;
      improve(best);
      TableChoice next = choose();
      if (next.worst < best.worst || next.chosen.size() < best.chosen.size()) best = next;
      run_.tell(bound_.size(), best.worst);
    }
    return answer(fewer_instances(best));
  }

 private:
  /// Index of the app with this loss.
  Result<int> with(const Loss& loss) {
    for (std::size_t k = 0; k < lossy_.size(); ++k)
      if (lossy_[k].loss == loss) return static_cast<int>(k);
    Lossy lossy{loss, kept(app_, loss), {}};
    lossy.problems.reserve(scenarios_.size());
    for (const Scenario& scenario : scenarios_) {
      const Platform left = platform_under(platform_, scenario);
      XAUTO_ASSIGN(Problem problem,
                   Problem::create(release_of(app_under(app_, scenario), loss), platform_));
      problem.forbidden.assign(at(problem.num_xnodes) * at(problem.num_xpus), 0);
      for (std::size_t x = 0; x < platform_.xpus.size(); ++x)
        if (left.find(platform_.xpus[x].id) < 0)
          for (std::size_t i = 0; i < at(problem.num_xnodes); ++i)
            problem.forbidden[i * at(problem.num_xpus) + x] = 1;
      lossy.problems.push_back(std::move(problem));
    }
    lossy_.push_back(std::move(lossy));
    return static_cast<int>(lossy_.size()) - 1;
  }

  /// Half of the time, in equal shares of what is left of it.
  Status solve_each() {
    const std::size_t n = scenarios_.size();
    XAUTO_TRY(with({}));
    for (std::size_t s = 0; s < n; ++s) {
      const double share_s = run_.share_s(s);
      Loss loss;
      if (scenarios_[s].degraded) loss = least_loss_under(s, share_s / 2);
      XAUTO_ASSIGN(const int lossy, with(loss));
      XAUTO_ASSIGN(const PriorityPlan policy,
                   solve_under(s, loss, scenarios_[s].degraded ? share_s / 2 : share_s, {}));
      lossy_of_.push_back(lossy);
      bound_.push_back(std::max<Time>(1, policy.lower_bound_us));
      const Platform left = platform_under(platform_, scenarios_[s]);
      TableCandidate candidate;
      candidate.loss = lossy;
      std::vector<Time> starts;
      for (const PriorityPlacement& p : policy.placements) {
        candidate.xpu.push_back(platform_.find(left.xpus[at(p.xpu)].id));
        starts.push_back(p.start_us);
      }
      candidate.sequence = sequence_of(priorities_by_key(starts));
      solved_.push_back(std::move(candidate));
      run_.tell(bound_.size(), kCannotServe);
    }
    for (TableCandidate& candidate : solved_) add(std::move(candidate));
    return {};
  }

  /// What is left under scenario `s`, solved alone. `enough`: a worst case that needs no improvement.
  Result<PriorityPlan> solve_under(std::size_t s, const Loss& loss, double seconds,
                                   std::optional<Time> enough) const {
    std::atomic<bool> stop{false};
    SolveOptions solving;
    solving.ordered_only = true;
    solving.threads = options_.threads;
    solving.seed = options_.seed + s;
    solving.stop = enough ? &stop : options_.stop;
    solving.max_evaluations = options_.max_evaluations;
    solving.time_limit_s = seconds;
    if (enough)
      solving.on_progress = [&](const Progress& progress) {
        const bool decided = progress.ordered <= *enough || progress.bound > *enough;
        const bool told = options_.stop != nullptr && options_.stop->load();
        if (decided || told) stop.store(true);
      };
    return solve(release_of(app_under(app_, scenarios_[s]), loss),
                 platform_under(platform_, scenarios_[s]), solving);
  }

  /// The least that was found with which the app keeps what a release has time for; all that it may
  /// lose, where it does not even so.
  [[nodiscard]] Loss least_loss_under(std::size_t s, double seconds) const {
    const Time limit = *app_.chains.front().deadline_us;  // all have the same
    const double until_s = run_.elapsed() + seconds;
    const auto suffices = [&](const Loss& loss) {
      const auto policy = solve_under(
          s, loss,
          std::max(kLeastSearchS, std::min(seconds / kLossTries, until_s - run_.elapsed())), limit);
      return policy && policy->latency_us <= limit;
    };
    return least_loss(app_, platform_under(platform_, scenarios_[s]), suffices,
                      run_.until_after(seconds))
        .loss;
  }

  /// On XPUs that are there under the scenario.
  [[nodiscard]] bool runs(const TableCandidate& plan, std::size_t s) const {
    const Problem& problem = lossy_[at(plan.loss)].problems[s];
    for (std::size_t i = 0; i < plan.xpu.size(); ++i)
      if (problem.wcet_on(static_cast<int>(i), plan.xpu[i]) == kCannotRun) return false;
    return true;
  }

  /// With its regrets; what is there already is not added again. A scenario is served by plans of its
  /// own loss alone: with more it would lose without need, and less was not found to suffice.
  void add(TableCandidate candidate) {
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      if (candidate.loss != lossy_of_[s] || !runs(candidate, s)) {
        candidate.regret.push_back(kCannotServe);
        continue;
      }
      OrderedEvaluator evaluator(problem(candidate, s));
      evaluator.reset(candidate.xpu, candidate.sequence);
      candidate.sequence = evaluator.sequence();
      candidate.regret.push_back(static_cast<double>(evaluator.makespan()) /
                                 static_cast<double>(bound_[s]));
    }
    if (known_.insert({candidate.loss, candidate.xpu, candidate.sequence}).second)
      candidates_.push_back(std::move(candidate));
  }
  [[nodiscard]] const Problem& problem(const TableCandidate& plan, std::size_t s) const {
    return lossy_[at(plan.loss)].problems[s];
  }

  [[nodiscard]] std::vector<std::vector<double>> regrets() const {
    std::vector<std::vector<double>> regret;
    for (const TableCandidate& c : candidates_) regret.push_back(c.regret);
    return regret;
  }
  [[nodiscard]] TableChoice choose() const { return run_.choose(regrets()); }
  [[nodiscard]] TableChoice fewer_instances(const TableChoice& choice) const {
    std::vector<std::vector<int>> xpu;  // [candidate][XNode of the app]
    for (const TableCandidate& c : candidates_) {
      const std::vector<int>& of = lossy_[at(c.loss)].kept;
      std::vector<int>& all = xpu.emplace_back(app_.xnodes.size(), -1);
      for (std::size_t i = 0; i < of.size(); ++i) all[at(of[i])] = c.xpu[i];
    }
    return run_.fewer_instances(regrets(), xpu, choice);
  }

  /// Every assignment with every order of what nothing is taken from, where they are few. Candidates are
  /// those that no other one beats under all scenarios.
  bool try_all() {
    const Problem& any = lossy_.front().problems.front();
    const std::size_t n = at(any.num_xnodes);
    std::vector<std::vector<int>> orders;
    std::vector<int> order;
    if (n > kMostOrdered || !all_orders(any, order, orders)) return false;
    std::vector<std::vector<int>> may(n);
    double tables = static_cast<double>(orders.size() * scenarios_.size());
    for (std::size_t i = 0; i < n; ++i) {
      for (int m = 0; m < any.num_xpus; ++m)
        if (std::ranges::any_of(lossy_.front().problems, [&](const Problem& problem) {
              return problem.wcet_on(static_cast<int>(i), m) != kCannotRun;
            }))
          may[i].push_back(m);
      tables *= static_cast<double>(may[i].size());
    }
    if (tables > kMostTried) return false;
    std::vector<OrderedEvaluator> evaluators;
    for (const Problem& problem : lossy_.front().problems) evaluators.emplace_back(problem);
    std::vector<TableCandidate> best;
    std::vector<std::size_t> choice(n, 0);
    for (std::size_t i = 0; i < n;) {
      TableCandidate table;
      for (std::size_t k = 0; k < n; ++k) table.xpu.push_back(may[k][choice[k]]);
      for (const std::vector<int>& sequence : orders) {
        table.sequence = sequence;
        rate(table, evaluators);
        keep_if_best(table, best);
      }
      if (best.size() > kMostBest || (options_.stop != nullptr && options_.stop->load()))
        return false;
      for (i = 0; i < n && ++choice[i] == may[i].size(); ++i) choice[i] = 0;
    }
    for (TableCandidate& table : best) {
      table.regret.clear();
      add(std::move(table));
    }
    return true;
  }

  /// Each linear extension that begins with `order`. False: they are too many.
  static bool all_orders(const Problem& problem, std::vector<int>& order,
                         std::vector<std::vector<int>>& orders) {
    if (order.size() == at(problem.num_xnodes)) {
      orders.push_back(order);
      return static_cast<double>(orders.size()) <= kMostTried;
    }
    const auto placed = [&](int i) { return std::ranges::find(order, i) != order.end(); };
    for (int i = 0; i < problem.num_xnodes; ++i) {
      if (placed(i) || !std::ranges::all_of(problem.pred[at(i)], placed)) continue;
      order.push_back(i);
      const bool few = all_orders(problem, order, orders);
      order.pop_back();
      if (!few) return false;
    }
    return true;
  }

  void rate(TableCandidate& table, std::vector<OrderedEvaluator>& evaluators) const {
    table.regret.clear();
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      if (!runs(table, s)) {
        table.regret.push_back(kCannotServe);
        continue;
      }
      evaluators[s].reset(table.xpu, table.sequence);
      table.regret.push_back(static_cast<double>(evaluators[s].makespan()) /
                             static_cast<double>(bound_[s]));
    }
  }

  static void keep_if_best(const TableCandidate& table, std::vector<TableCandidate>& best) {
    const auto no_worse = [](const TableCandidate& a, const TableCandidate& b) {
      return std::ranges::equal(a.regret, b.regret, std::ranges::less_equal());
    };
    if (std::ranges::any_of(best, [&](const auto& other) { return no_worse(other, table); }))
      return;
    std::erase_if(best, [&](const auto& other) { return no_worse(table, other); });
    best.push_back(table);
  }

  /// One candidate more for each group of scenarios that a table serves, and for each with one more
  /// of those that limit.
  void improve(const TableChoice& choice) {
    struct Task {
      std::vector<int> group;
      int from;
      std::uint64_t seed;
      TableCandidate result;
    };
    std::vector<Task> tasks;
    for (const int c : choice.chosen) {
      Task task{{}, c, random_.next(), {}};
      for (std::size_t s = 0; s < scenarios_.size(); ++s)
        if (choice.serves[s] == c) task.group.push_back(static_cast<int>(s));
      if (!task.group.empty()) tasks.push_back(std::move(task));
    }
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      if (candidates_[at(choice.serves[s])].regret[s] < choice.worst) continue;
      for (const int c : choice.chosen) {
        if (c == choice.serves[s] || candidates_[at(c)].regret[s] == kCannotServe) continue;
        Task task{{static_cast<int>(s)}, c, random_.next(), {}};
        for (std::size_t other = 0; other < scenarios_.size(); ++other)
          if (choice.serves[other] == c) task.group.push_back(static_cast<int>(other));
        tasks.push_back(std::move(task));
      }
    }
    const double slice =
        std::min(kMostSearchS, std::max(kLeastSearchS, options_.time_limit_s - run_.elapsed()) /
                                   static_cast<double>(tasks.size()));
    run_.on_threads(tasks.size(), [&](std::size_t k) {
      tasks[k].result = anneal_for(tasks[k].group, tasks[k].from, tasks[k].seed, slice);
    });
    for (Task& task : tasks) add(std::move(task.result));
  }

  /// One step of anneal_for().
  struct Change {
    int xnode;
    bool moves;    ///< to another XPU; else in the sequence
    int to;        ///< an XPU or a position
    int with;      ///< whose XPU it is that takes this one's instead; or -1
    int from_xpu;  ///< the XPU that it has
  };

  /// Nothing where what was drawn changes nothing, or cannot run in some scenario of `group`.
  [[nodiscard]] std::optional<Change> propose(const OrderedEvaluator& now,
                                              const std::vector<int>& group, int from,
                                              const std::vector<int>& chain, Random& random) const {
    const std::vector<int>& xpu = now.xpu();
    const std::size_t n = xpu.size();
    const int i = !chain.empty() && random.below(2) == 0 ? chain[random.below(chain.size())]
                                                         : static_cast<int>(random.below(n));
    const bool moves = random.below(kOneInMoves) == 0;
    const int from_xpu = xpu[at(i)];
    if (moves) {
      const auto runs_on = [&](int node, int m) {
        return std::all_of(group.begin(), group.end(), [&](int s) {
          return problem(candidates_[at(from)], at(s)).wcet_on(node, m) != kCannotRun;
        });
      };
      const int with = random.below(kOneExchanges) == 0 ? static_cast<int>(random.below(n)) : -1;
      const int to =
          with >= 0 ? xpu[at(with)] : static_cast<int>(random.below(platform_.xpus.size()));
      if (to == from_xpu || !runs_on(i, to) || (with >= 0 && !runs_on(with, from_xpu))) return {};
      return Change{i, true, to, with, from_xpu};
    }
    int to = static_cast<int>(random.below(n));
    if (random.below(2) == 0) {  // nearby
      const int here = now.position(i);
      to = std::clamp(here + static_cast<int>(random.below(2 * kNearby + 1)) - kNearby, 0,
                      static_cast<int>(n) - 1);
    }
    if (to == now.position(i)) return {};
    return Change{i, false, to, -1, from_xpu};
  }

  /// Anneals a candidate for some scenarios at once: the largest of makespan / bound.
  [[nodiscard]] TableCandidate anneal_for(const std::vector<int>& group, int from,
                                          std::uint64_t seed, double seconds) const {
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    Random random(seed);
    std::vector<OrderedEvaluator> evaluators;
    for (const int s : group) {
      evaluators.emplace_back(problem(candidates_[at(from)], at(s)));
      evaluators.back().reset(candidates_[at(from)].xpu, candidates_[at(from)].sequence);
    }
    const auto ratio = [&](std::size_t k) {
      return static_cast<double>(evaluators[k].makespan()) /
             static_cast<double>(bound_[at(group[k])]);
    };
    const auto worst = [&] {
      std::size_t most = 0;
      for (std::size_t k = 1; k < evaluators.size(); ++k)
        if (ratio(k) > ratio(most)) most = k;
      return most;
    };
    std::size_t limiting = worst();
    double current = ratio(limiting), best = current;
    TableCandidate found{
        evaluators[0].xpu(), evaluators[0].sequence(), {}, candidates_[at(from)].loss};
    std::vector<int> chain;
    evaluators[limiting].critical_chain(chain);
    const std::int64_t most_moves =
        options_.max_evaluations > 0 ? options_.max_evaluations : std::int64_t{1} << 60;
    double heat = kTableHot;
    for (std::int64_t move = 0; move < most_moves && best > 1; ++move) {
      if (move % kTableMovesPerLook == 0) {
        if (options_.max_evaluations == 0 && std::chrono::steady_clock::now() >= deadline) break;
        heat = std::max(heat * kTableCools, kTableCold);
        if (move % kMovesPerHeating == 0) heat = kTableHot;
      }
      const std::optional<Change> change = propose(evaluators[0], group, from, chain, random);
      if (!change) continue;
      const double limit = current * (1 - heat * std::log(random.unit()) * kHeatCounts);
      bool within = true;
      std::size_t tried = 0;
      // The one that limits is the likeliest to refuse.
      for (std::size_t step = 0; step < evaluators.size() && within; ++step) {
        const std::size_t k = step == 0 ? limiting : step <= limiting ? step - 1 : step;
        OrderedEvaluator& evaluator = evaluators[k];
        if (change->moves)
          evaluator.assign(change->xnode, change->to);
        else
          evaluator.reposition(change->xnode, change->to);
        if (change->with >= 0) evaluator.assign(change->with, change->from_xpu);
        ++tried;
        const auto most = static_cast<Time>(limit * static_cast<double>(bound_[at(group[k])])) + 1;
        within = evaluator.evaluate(most) != kNever;
      }
      for (std::size_t step = 0; step < tried; ++step) {
        const std::size_t k = step == 0 ? limiting : step <= limiting ? step - 1 : step;
        within ? evaluators[k].commit() : evaluators[k].rollback();
      }
      if (!within) continue;
      limiting = worst();
      current = ratio(limiting);
      evaluators[limiting].critical_chain(chain);
      if (current >= best) continue;
      best = current;
      found.xpu = evaluators[0].xpu();
      found.sequence = evaluators[0].sequence();
    }
    return found;
  }

  Result<Tables> answer(const TableChoice& choice) {
    if (choice.chosen.empty())
      return fail(ErrorCode::kInfeasible,
                  "no " + std::to_string(options_.tables) +
                      " tables serve every scenario: they have lost different XPUs" +
                      (lossy_.size() > 1 ? ", or the app loses different things there" : ""),
                  app_.name, "ask for more tables");
    XAUTO_TRY(run_.judge(choice.worst, app_.name));
    Tables tables;
    tables.app = app_.name;
    tables.app_hash = app_.hash();
    tables.platform = platform_.name;
    tables.scenarios = scenarios_;
    std::vector<int> used = choice.serves;
    std::sort(used.begin(), used.end());
    used.erase(std::unique(used.begin(), used.end()), used.end());
    // In the order of the scenarios that they serve first.
    std::vector<int> number(candidates_.size(), -1), chosen;
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      const std::size_t c = at(choice.serves[s]);
      if (number[c] < 0) {
        number[c] = static_cast<int>(chosen.size());
        chosen.push_back(static_cast<int>(c));
      }
      tables.serves.push_back({number[c]});
      tables.serves.back().lower_bound_us = bound_[s];
    }
    tables.tables.resize(chosen.size());
    for (std::size_t t = 0; t < chosen.size(); ++t)
      XAUTO_TRY(put(candidates_[at(chosen[t])], t, tables));
    for (std::size_t s = 0; s < scenarios_.size(); ++s) set_bounds(s, tables.serves[s]);
    keys::set_claims(tables, app_, platform_);
    tables.handovers = keys::releases_across(tables, app_, platform_);
    tables.solve_us = static_cast<std::int64_t>(run_.elapsed() * 1e6);
    return tables;
  }

  /// Table `t` in the candidate's sequence: its keys at its envelope, and what they claim. The order pairs are those of
  /// any scenario. `tables` says whom it serves.
  Status put(const TableCandidate& plan, std::size_t t, Tables& tables) const {
    const Lossy& lossy = lossy_[at(plan.loss)];
    Table& table = tables.tables[t];
    table.loss = lossy.loss;
    table.name = name_of_table(t, table.loss, app_);
    const Scenario all = envelope(tables, t, app_);
    const AppSpec left = app_under(app_, all, table.loss);
    const Platform on = platform_with(platform_under(platform_, all), table.loss.off);
    Policy keys;
    for (const XNodeSpec& x : app_.xnodes) keys.placements.push_back({on.find(off_xpu(x.module))});
    const auto id = [&](std::size_t i) { return platform_.xpus[at(plan.xpu[i])].id; };
    for (std::size_t i = 0; i < lossy.kept.size(); ++i)
      keys.placements[at(lossy.kept[i])].xpu = on.find(id(i));
    const Solution solution{plan.xpu, plan.sequence, 0, true, {}};
    for (const auto& [u, v] : order_pairs(lossy.problems.front(), solution))
      keys.order.emplace_back(lossy.kept[at(u)], lossy.kept[at(v)]);
    std::vector<int> sequence;
    for (const int i : plan.sequence) sequence.push_back(lossy.kept[at(i)]);
    for (const int i : app_.topological_order())  // what is off waits for others, and nobody for it
      if (table.loss.is_off(app_.xnodes[at(i)].module)) sequence.push_back(i);
    XAUTO_ASSIGN(const keys::Problem p, keys::Problem::create(left, on, {}, keys.order));
    keys::set_sequence_keys(p, sequence, keys);
    for (const ChainSpec& chain : app_.chains) keys.chains.push_back({chain.name, kNotThere});
    for (const int c : kept_chains(app_, table.loss))
      keys.chains[at(c)].worst_case_us = keys.placements[at(app_.chains[at(c)].to)].key_us.front();
    for (std::size_t i = 0; i < keys.placements.size(); ++i)
      keys.placements[i].xpu = table.loss.is_off(app_.xnodes[i].module)
                                   ? -1
                                   : platform_.find(on.xpus[at(keys.placements[i].xpu)].id);
    table.keys = std::move(keys);
    return {};
  }

  /// Of each chain alone; of the only one what is proven of the release.
  void set_bounds(std::size_t s, Served& served) const {
    const Loss& loss = lossy_[at(lossy_of_[s])].loss;
    const AppSpec left = app_under(app_, scenarios_[s], loss);
    const Platform on = platform_with(platform_under(platform_, scenarios_[s]), loss.off);
    served.chain_bound_us.assign(app_.chains.size(), kNotThere);
    const std::vector<int> there = kept_chains(app_, loss);
    const auto p = keys::Problem::create(left, on);
    for (const int c : there) {
      std::int64_t& bound = served.chain_bound_us[at(c)];
      bound = there.size() == 1 ? served.lower_bound_us : 0;
      if (!p || there.size() == 1) continue;
      bound = keys::quick_release_bound(left, on, *p, app_.chains[at(c)].to, {}, {}) / p->scale;
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const std::vector<Scenario>& scenarios_;
  const TablesOptions& options_;
  const TablesRun run_;
  Random random_;
  std::vector<Lossy> lossy_;   ///< the first without any loss
  std::vector<int> lossy_of_;  ///< [scenario] index into them
  std::vector<Time> bound_;    ///< [scenario] of what its loss leaves
  std::vector<TableCandidate> solved_;
  std::vector<TableCandidate> candidates_;
  std::set<std::tuple<int, std::vector<int>, std::vector<int>>> known_;
};

/// Releases are alone, and how long one takes says all: every end is that of a chain, also where optional modules are
/// off; all deadlines are the same; and messages take no time, which OrderedEvaluator does not know of.
bool is_one_length(const AppSpec& app) {
  if (!app.one_at_a_time || app.chains.empty()) return false;
  std::vector<char> ends = ends_of(app);
  for (const ChainSpec& chain : app.chains) ends[at(chain.to)] = 0;
  return std::ranges::all_of(ends, [](char end) { return end == 0; }) &&
         std::ranges::all_of(app.chains,
                             [&](const ChainSpec& chain) {
                               return chain.deadline_us == app.chains.front().deadline_us;
                             }) &&
         std::ranges::all_of(app.transfers, [](const auto& t) { return t.transfer_us == 0; });
}

}  // namespace

Result<Tables> solve_tables(const AppSpec& app, const Platform& platform,
                            const Scenarios& scenarios, const TablesOptions& options) {
  if (options.tables <= 0 && options.regret < 1)
    return fail(ErrorCode::kInvalid, "say how many tables, or within which regret", app.name);
  if (!platform.hosts.empty())
    return fail(ErrorCode::kInvalid,
                "it has several hosts: no table changes on two of them at once",
                "platform '" + platform.name + "'", "plan tables for each computer's own app");
  XAUTO_TRY(validate(scenarios, app, platform));
  for (std::size_t s = 0; s < scenarios.list.size(); ++s)
    if (scenarios.list[s].degraded && !app.has_deadlines())
      return fail(ErrorCode::kInvalid,
                  "no chain has a deadline: nothing says for what the app would lose anything",
                  "/scenarios/" + std::to_string(s) + "/degraded",
                  "give chains of app.json deadline_us, or leave degraded out");
  if (!is_one_length(app)) return keys::solve_key_tables(app, platform, scenarios, options);
  return TablesSearch(app, platform, scenarios, options).run();
}

}  // namespace xauto::solver

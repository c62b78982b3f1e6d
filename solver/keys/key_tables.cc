// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/key_tables.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "base/index.h"
#include "model/components.h"
#include "solver/keys/changes.h"
#include "solver/keys/sequence.h"
#include "solver/keys/solve.h"
#include "solver/least_loss.h"
#include "solver/random.h"
#include "solver/tables_run.h"

namespace xauto::solver::keys {
namespace {

/// Keys that are certified for an envelope.
struct KeyTable {
  Scenario of;                 ///< the envelope
  std::size_t loss = 0;        ///< index into KeyTablesSearch::losses_
  Policy policy;               ///< of what that leaves of the scenario's app, and its platform
  double value = 0;            ///< of its worst cases, what is compared
  std::vector<double> regret;  ///< [scenario]
};

/// How one of them is searched.
struct How {
  Keep keep = Keep::kNothing;  ///< of the hint
  int slack_pct = 0;           ///< every WCET counts as longer by so much
  bool in_time = false;        ///< it may end where every chain keeps its deadline
  bool together = false;       ///< clocks may share XPUs, also where each one has its own
};

// ---- constants of the search --------------------------------------------------------------------
// None is tuned: each was chosen when what it belongs to was written, and no measurement of its
// neighbours is kept. `bench_tables` shows what a change does.

/// Share of the time limit for changes; and where some change has no worst case yet.
constexpr double kForChanges = 0.2, kForClaims = 0.4;
/// Slices that it is cut into, each for one search; all worst cases of changes at once have four.
constexpr double kSlicesForChanges = 12, kSlicesForHandovers = 4;
/// XPUs of its own for each clock. Share of the limit for one split; so many of it for the search
/// where clocks share them; share for all splits.
constexpr double kForSplit = 1.0 / 200, kSplitsForShared = 4, kForSplits = 0.25;
/// Of a scenario's share: its bounds, where each clock has XPUs of its own in the tables.
constexpr double kForBounds = 0.25;
constexpr double kForWhole = 0.1;  ///< of what is left: one table for all scenarios
/// Of so few scenarios a table of each set of them is searched, in a share of what is left together.
constexpr std::size_t kFewScenarios = 4;
constexpr double kForSets = 0.2;
constexpr double kForClaimed = 1.0 / 50;  ///< whether each change has a worst case
/// Searches for the least loss that a scenario's share is divided by.
constexpr double kLossTries = 8;
/// Seconds of a search at least; of one for a table, and for the table of all. At most, of one that
/// improves a table.
constexpr double kLeastSearchS = 0.02, kLeastForTableS = 0.05, kLeastForWholeS = 0.1,
                 kMostSearchS = 1;

// Where evaluations are counted, time is not, and rounds end the search: all of the tables, and for
// changes, per table.
constexpr int kTableRounds = 12, kChangeRounds = 3;

/// Slack of each XPU, percent, in tables whose changes do not settle without.
constexpr int kSlackPct = 3;
/// How much more regret a scenario may have, so that changes are shorter; so that more is claimed
/// of them, or fewer deadlines are missed.
constexpr double kMostForChanges = 1.01, kMostForClaims = 1.15;
constexpr double kLeastValue = 1e-9;  ///< of a bound that regrets are divided by

class KeyTablesSearch {
 public:
  KeyTablesSearch(const AppSpec& app, const Platform& platform, const Scenarios& scenarios,
                  const TablesOptions& options)
      : app_(app),
        platform_(platform),
        scenarios_(scenarios.list),
        options_(options),
        run_(options, scenarios.list.size()),
        random_(options.seed) {
    for (const Scenario& scenario : scenarios_) under_.push_back(app_under(app, scenario));
  }

  Result<Tables> run() {
    XAUTO_TRY(split_by_clock());
    XAUTO_TRY(solve_each());
    for (std::size_t loss = 0; loss < losses_.size(); ++loss) solve_all(loss);
    solve_sets();
    TableChoice best = choose();
    std::optional<bool> all_claimed;
    for (int round = 0; options_.max_evaluations == 0 || round < kTableRounds; ++round) {
      if (run_.over() || best.chosen.empty() || best.worst <= run_.goal()) break;
      if (options_.max_evaluations == 0 && is_time(kForClaims)) {
        if (!all_claimed) all_claimed = claims_all(best);
        if (!*all_claimed || is_time(kForChanges)) break;
      }
      improve(best);
      best = choose();
      run_.tell(bound_.size(), best.worst);
    }
    return answer(fewer_instances(best));
  }

 private:
  /// Whether so many searches of `slice` seconds each end in time.
  [[nodiscard]] bool fit(std::size_t searches, double slice) const {
    if (run_.over() || options_.max_evaluations > 0) return !run_.over();
    const auto threads = static_cast<std::size_t>(std::max(1, options_.threads));
    const std::size_t turns = (searches + threads - 1) / threads;
    return run_.elapsed() + static_cast<double>(turns) * slice <= options_.time_limit_s;
  }

  /// Whether no more than that share of the time is left.
  [[nodiscard]] bool is_time(double share) const {
    return run_.elapsed() >= options_.time_limit_s * (1 - share);
  }

  [[nodiscard]] double value_of(const std::vector<std::int64_t>& us) const {
    return chain_objective(app_, us).value;
  }

  /// A change has a worst case where clocks share no XPU: for each type, how many of its
  /// XPUs each clock has. Of the first splits, as many as there is time for, the one that costs least under the
  /// first scenario. It is taken where that is at most kMostForClaims, or where no chain misses its
  /// deadline by it: a change that is not certified may miss all of them.
  Status split_by_clock() {
    XAUTO_ASSIGN(const Components components, find_components(app_));
    const std::size_t clocks = components.domains.size();
    for (const int c : components.of) clock_of_.push_back(components.components[at(c)].domain);
    if (clocks < 2) return {};
    std::vector<int> owner(platform_.xpus.size(), 0), best;
    const double slice = std::max(kLeastSearchS, options_.time_limit_s * kForSplit);
    const auto shared = solve_for(scenarios_.front(), {}, kSplitsForShared * slice,
                                  options_.threads, options_.seed, nullptr);
    if (!shared || shared->outcome != Outcome::kPolicy) return {};
    const double cheap = kMostForClaims * value_of(worst_cases(shared->policy));
    double most = std::max(cheap, app_.has_deadlines() ? 1.0 : 0.0);
    do {
      if (run_.elapsed() > options_.time_limit_s * kForSplits) break;
      forbids_ = forbids_of(owner);
      const auto answer =
          solve_for(scenarios_.front(), {}, slice, options_.threads, options_.seed, nullptr);
      if (!answer || answer->outcome != Outcome::kPolicy) continue;
      const double value = value_of(worst_cases(answer->policy));
      if (value > most) continue;
      most = value;
      best = owner;
    } while (next_split(owner, static_cast<int>(clocks)));
    forbids_.clear();
    if (best.empty()) return {};
    auto forbids = forbids_of(best);
    for (std::size_t s = 1; s < scenarios_.size() && most > cheap; ++s) {
      if (keeps_deadlines(s, slice, forbids) || !keeps_deadlines(s, slice, {})) continue;
      return {};
    }
    forbids_ = std::move(forbids);
    return {};
  }

  using Forbids = std::vector<std::pair<std::string, std::string>>;
  /// As far as is found in so many seconds.
  [[nodiscard]] bool keeps_deadlines(std::size_t scenario, double seconds, Forbids forbids) {
    forbids_.swap(forbids);
    const auto answer =
        solve_for(scenarios_[scenario], {}, seconds, options_.threads, options_.seed, nullptr);
    forbids_.swap(forbids);
    return answer && answer->outcome == Outcome::kPolicy &&
           value_of(worst_cases(answer->policy)) <= 1;
  }

  /// XPUs of a type are alike: of all splits with the same counts the one in which owners do not fall.
  [[nodiscard]] bool next_split(std::vector<int>& owner, int clocks) const {
    for (std::size_t x = owner.size(); x-- > 0;) {
      if (owner[x] + 1 == clocks) continue;
      ++owner[x];
      for (std::size_t y = x + 1; y < owner.size(); ++y) {
        owner[y] = 0;
        for (std::size_t z = 0; z < y; ++z)
          if (platform_.xpus[z].type == platform_.xpus[y].type)
            owner[y] = std::max(owner[y], owner[z]);
      }
      return true;
    }
    return false;
  }

  [[nodiscard]] Forbids forbids_of(const std::vector<int>& owner) const {
    Forbids forbids;
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
      for (std::size_t x = 0; x < owner.size(); ++x)
        if (owner[x] != clock_of_[i])
          forbids.emplace_back(app_.xnodes[i].name, platform_.xpus[x].id);
    return forbids;
  }

  /// [chain of the app], of those that are left.
  [[nodiscard]] std::vector<std::int64_t> of_all_chains(const std::vector<std::int64_t>& us,
                                                        const Loss& loss) const {
    std::vector<std::int64_t> all(app_.chains.size(), kNotThere);
    const std::vector<int> there = kept_chains(app_, loss);
    for (std::size_t k = 0; k < there.size(); ++k) all[at(there[k])] = us[k];
    return all;
  }

  [[nodiscard]] Platform platform_for(const Scenario& scenario, const Loss& loss) const {
    return platform_with(platform_under(platform_, scenario), loss.off);
  }

  [[nodiscard]] Result<Answer> solve_for(const Scenario& scenario, const Loss& loss, double seconds,
                                         int threads, std::uint64_t seed, const Policy* hint,
                                         const How& how = {}) const {
    Options solving;
    const Platform left = platform_for(scenario, loss);
    for (const auto& [xnode, xpu] : how.together ? Forbids{} : forbids_)
      if (left.find(xpu) >= 0 && !loss.is_off(app_.xnodes[at(app_.find(xnode))].module))
        solving.wishes.forbids.emplace_back(xnode, xpu);
    std::atomic<bool> enough{false};
    if (how.in_time)
      solving.on_progress = [&](const Progress& progress) {
        const bool told = options_.stop != nullptr && options_.stop->load();
        if (progress.late <= 1 || told) enough.store(true);
      };
    solving.aim =
        app_.has_deadlines() || app_.one_at_a_time ? Aim::kLargest : Aim::kSum;  // as value_of()
    solving.time_limit_s = seconds;
    solving.threads = threads;
    solving.seed = seed;
    solving.max_evaluations = options_.max_evaluations;
    solving.stop = how.in_time ? &enough : options_.stop;
    solving.hint = hint;
    solving.keep = how.keep;
    solving.order = app_.one_at_a_time;
    AppSpec app = app_under(app_, scenario, loss);
    if (how.slack_pct > 0) lengthen(app, how.slack_pct);
    return solve(app, left, solving);
  }

  static void lengthen(AppSpec& app, int pct) {
    for (XNodeSpec& xnode : app.xnodes)
      for (auto& [type, us] : xnode.wcet_us) us = (us * 100 + (100 - pct) - 1) / (100 - pct);
  }

  /// The least that was found with which each chain that is left keeps its deadline; all that the app
  /// may lose, where they do not even so.
  [[nodiscard]] Loss least_loss_under(std::size_t s, double seconds) const {
    const double until_s = run_.elapsed() + seconds;
    const auto suffices = [&](const Loss& loss) {
      const std::vector<int> there = kept_chains(app_, loss);
      if (there.empty()) return true;  // solve_each refuses it
      const auto answer = solve_for(
          scenarios_[s], loss,
          std::max(kLeastSearchS, std::min(seconds / kLossTries, until_s - run_.elapsed())),
          options_.threads, options_.seed + s, nullptr, {.in_time = true});
      if (!answer || answer->outcome != Outcome::kPolicy) return false;
      for (std::size_t k = 0; k < there.size(); ++k) {
        const ChainClaim& claim = answer->policy.chains[k];
        const std::int64_t limit = app_.chains[at(there[k])].deadline_us.value_or(INT64_MAX);
        if (std::max(claim.worst_case_us, claim.urgent_worst_case_us.value_or(0)) > limit)
          return false;
      }
      return true;
    };
    return least_loss(app_, platform_under(platform_, scenarios_[s]), suffices,
                      run_.until_after(seconds))
        .loss;
  }

  /// Its index; a new one if it is new.
  std::size_t number_of(const Loss& loss) {
    const auto found = std::find(losses_.begin(), losses_.end(), loss);
    if (found == losses_.end()) return losses_.push_back(loss), losses_.size() - 1;
    return static_cast<std::size_t>(found - losses_.begin());
  }

  /// Half of the time, in equal shares of what is left of it.
  Status solve_each() {
    const std::size_t n = scenarios_.size();
    for (std::size_t s = 0; s < n; ++s) {
      const bool degraded = scenarios_[s].degraded;
      const double share_s = run_.share_s(s) / (degraded ? 2 : 1);
      const std::string where = "scenario '" + scenarios_[s].name + "'";
      const std::size_t lossy = degraded ? number_of(least_loss_under(s, share_s)) : 0;
      const Loss loss = losses_[lossy];
      if (kept_chains(app_, loss).empty())
        return fail(ErrorCode::kInfeasible,
                    "its deadlines were only found to be kept where no chain is left", where,
                    "let less be optional, or leave the scenario out");
      // Bounds are of all policies, also of those in which clocks share XPUs.
      std::optional<Answer> bounds;
      if (!forbids_.empty()) {
        const auto forbids = std::exchange(forbids_, {});
        auto all = solve_for(scenarios_[s], loss, share_s * kForBounds, options_.threads,
                             options_.seed, nullptr);
        forbids_ = forbids;
        if (all) bounds = std::move(*all);
      }
      auto solved =
          solve_for(scenarios_[s], loss, share_s, options_.threads, options_.seed + s, nullptr);
      // An XNode may have no XPU left that its clock has: then this scenario is served as it can be.
      if (bounds && (!solved || solved->outcome != Outcome::kPolicy)) solved = *bounds;
      XAUTO_ASSIGN(Answer answer, std::move(solved));
      if (bounds) answer.lower_bound_us = bounds->lower_bound_us;
      if (answer.outcome == Outcome::kUnsustainable)
        return fail(ErrorCode::kInfeasible, "no policy keeps up: " + answer.overload.text, where,
                    "less work, longer periods, or leave the scenario out");
      if (answer.outcome == Outcome::kUnknown)
        return fail(ErrorCode::kInfeasible,
                    "no policy was found in " + std::to_string(share_s) +
                        " s, and that there is none is not proven",
                    where, "more time: --time-limit");
      loss_of_.push_back(lossy);
      bound_.push_back(of_all_chains(answer.lower_bound_us, loss));
      bound_value_.push_back(std::max(kLeastValue, value_of(bound_.back())));
      add(scenarios_[s], lossy, std::move(answer.policy));
      run_.tell(bound_.size(), kCannotServe);
    }
    for (KeyTable& table : candidates_) rate(table);
    return {};
  }

  /// A candidate that serves everything, where no scenario covers all others.
  void solve_all(std::size_t loss) {
    std::vector<int> all;
    for (std::size_t s = 0; s < scenarios_.size(); ++s)
      if (loss_of_[s] == loss) all.push_back(static_cast<int>(s));
    if (all.empty()) return;
    solve_together(all,
                   std::max(kLeastForWholeS, (options_.time_limit_s - run_.elapsed()) * kForWhole));
  }

  /// A candidate for all of `group`, of one loss, unless there is one.
  void solve_together(const std::vector<int>& group, double seconds) {
    const std::size_t loss = loss_of_[at(group.front())];
    const Scenario envelope = join(group);
    if (known(envelope, loss)) return;
    const auto answer =
        solve_for(envelope, losses_[loss], seconds, options_.threads, options_.seed, nullptr);
    if (!answer || answer->outcome != Outcome::kPolicy) return;
    add(envelope, loss, answer->policy);
    rate(candidates_.back());
  }

  /// improve() moves scenarios that limit, one at a time. It does not join two that do not, so that a
  /// table more is left for those that do.
  void solve_sets() {
    const std::size_t n = scenarios_.size();
    if (n > kFewScenarios || run_.most() < 2 || at(run_.most()) >= n) return;
    const double slice =
        std::max(kLeastForTableS, (options_.time_limit_s - run_.elapsed()) * kForSets /
                                      static_cast<double>(std::size_t{1} << n));
    for (std::size_t set = 1; set < std::size_t{1} << n && fit(1, slice); ++set) {
      std::vector<int> group;
      for (std::size_t s = 0; s < n; ++s)
        if ((set >> s & 1) != 0) group.push_back(static_cast<int>(s));
      const std::size_t loss = loss_of_[at(group.front())];
      if (std::ranges::all_of(group, [&](int s) { return loss_of_[at(s)] == loss; }))
        solve_together(group, slice);
    }
  }

  [[nodiscard]] Scenario join(const std::vector<int>& group) const {
    Scenario all = scenarios_[at(group.front())];
    for (std::size_t k = 1; k < group.size(); ++k)
      all = across(app_, all, scenarios_[at(group[k])]);
    return all;
  }
  [[nodiscard]] bool known(const Scenario& envelope, std::size_t loss) const {
    const AppSpec under = app_under(app_, envelope);
    return std::any_of(candidates_.begin(), candidates_.end(), [&](const KeyTable& table) {
      return table.loss == loss && covers(table.of, app_under(app_, table.of), envelope, under) &&
             covers(envelope, under, table.of, app_under(app_, table.of));
    });
  }

  void add(const Scenario& envelope, std::size_t loss, Policy policy) {
    candidates_.push_back(table_for(envelope, loss, std::move(policy)));
  }
  [[nodiscard]] KeyTable table_for(const Scenario& envelope, std::size_t loss,
                                   Policy policy) const {
    KeyTable table{envelope, loss, std::move(policy)};
    table.value = value_of(of_all_chains(worst_cases(table.policy), losses_[loss]));
    return table;
  }

  /// A scenario is served by tables of its own loss alone: with more it would lose without need, and less
  /// was not found to suffice.
  void rate(KeyTable& table) const {
    const AppSpec under = app_under(app_, table.of);
    table.regret.clear();
    for (std::size_t s = 0; s < scenarios_.size(); ++s)
      table.regret.push_back(table.loss == loss_of_[s] &&
                                     covers(table.of, under, scenarios_[s], under_[s])
                                 ? table.value / bound_value_[s]
                                 : kCannotServe);
  }

  [[nodiscard]] std::vector<std::vector<double>> regrets() const {
    std::vector<std::vector<double>> regret;
    for (const KeyTable& c : candidates_) regret.push_back(c.regret);
    return regret;
  }
  [[nodiscard]] TableChoice choose() const { return run_.choose(regrets()); }
  [[nodiscard]] TableChoice fewer_instances(const TableChoice& choice) const {
    std::vector<std::vector<int>> xpu;  // [candidate][XNode]
    for (const KeyTable& c : candidates_) {
      std::vector<int>& all = xpu.emplace_back();
      for (const Placement& p : hint_for(c, {}).placements) all.push_back(on_platform(p.xpu));
    }
    return run_.fewer_instances(regrets(), xpu, choice);
  }
  /// -1: of what is off, whose XPUs come after the others.
  [[nodiscard]] int on_platform(int xpu) const {
    return xpu < static_cast<int>(platform_.xpus.size()) ? xpu : -1;
  }

  /// Whether clocks share XPUs there although others have their own: no other policy was found for it.
  [[nodiscard]] bool is_together(const KeyTable& table) const {
    const std::vector<Placement> placed = hint_for(table, {}).placements;
    return std::any_of(forbids_.begin(), forbids_.end(), [&](const auto& forbid) {
      const int xpu = on_platform(placed[at(app_.find(forbid.first))].xpu);
      return xpu >= 0 && platform_.xpus[at(xpu)].id == forbid.second;
    });
  }
  /// The policy of a candidate on the platform that is left under another envelope.
  [[nodiscard]] Policy hint_for(const KeyTable& table, const Scenario& envelope) const {
    const Platform had = platform_for(table.of, losses_[table.loss]),
                   has = platform_for(envelope, losses_[table.loss]);
    Policy hint = table.policy;
    for (Placement& p : hint.placements)
      if (p.xpu >= 0) p.xpu = has.find(had.xpus[at(p.xpu)].id);
    return hint;
  }

  void improve(const TableChoice& choice) {
    struct Task {
      std::vector<int> group;
      int from;
      std::uint64_t seed;
      Result<Answer> result = Answer();
    };
    std::vector<Task> tasks;
    const auto group_of = [&](int c) {
      std::vector<int> group;
      for (std::size_t s = 0; s < scenarios_.size(); ++s)
        if (choice.serves[s] == c) group.push_back(static_cast<int>(s));
      return group;
    };
    for (const int c : choice.chosen)
      if (std::vector<int> group = group_of(c); !group.empty())
        tasks.push_back({std::move(group), c, random_.next()});
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      if (candidates_[at(choice.serves[s])].regret[s] < choice.worst) continue;
      for (const int c : choice.chosen) {
        std::vector<int> group = group_of(c);
        if (c == choice.serves[s] || group.empty() || candidates_[at(c)].loss != loss_of_[s])
          continue;
        group.push_back(static_cast<int>(s));
        if (known(join(group), loss_of_[s])) continue;
        tasks.push_back({std::move(group), c, random_.next()});
      }
    }
    const double slice =
        std::min(kMostSearchS, std::max(kLeastForTableS, options_.time_limit_s - run_.elapsed()) *
                                   static_cast<double>(options_.threads) /
                                   static_cast<double>(tasks.size()));
    run_.on_threads(tasks.size(), [&](std::size_t k) {
      const Scenario envelope = join(tasks[k].group);
      const Policy hint = hint_for(candidates_[at(tasks[k].from)], envelope);
      const bool placed = std::any_of(hint.placements.begin(), hint.placements.end(),
                                      [](const Placement& p) { return p.xpu >= 0; });
      const KeyTable& from = candidates_[at(tasks[k].from)];
      tasks[k].result = solve_for(envelope, losses_[from.loss], slice, 1, tasks[k].seed,
                                  placed ? &hint : nullptr, {.together = is_together(from)});
    });
    for (const Task& task : tasks) {
      if (!task.result || task.result->outcome != Outcome::kPolicy) continue;
      add(join(task.group), candidates_[at(task.from)].loss, task.result->policy);
      rate(candidates_.back());
    }
  }

  Result<Tables> answer(const TableChoice& choice) {
    if (choice.chosen.empty())
      return fail(ErrorCode::kInfeasible,
                  "no " + std::to_string(run_.most()) +
                      " tables were found that serve every scenario: no policy was found for the "
                      "longest WCETs of several of them together",
                  app_.name, "ask for more tables, or give it more time");
    XAUTO_TRY(run_.judge(choice.worst, app_.name));
    XAUTO_ASSIGN(Tables tables, with_cheap_changes(choice));
    tables.solve_us = static_cast<std::int64_t>(run_.elapsed() * 1e6);
    return tables;
  }

  /// All but handovers. `candidate`: [table] which it is.
  [[nodiscard]] Tables tables_of(const TableChoice& choice, std::vector<int>& candidate) const {
    Tables tables;
    tables.app = app_.name;
    tables.app_hash = app_.hash();
    tables.platform = platform_.name;
    tables.scenarios = scenarios_;
    tables.notice_us = app_.one_at_a_time ? 0 : kNoticeUs;  // then nothing is in flight
    candidate.clear();
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      const int c = choice.serves[s];
      const auto known = std::find(candidate.begin(), candidate.end(), c);
      const auto number = static_cast<int>(known - candidate.begin());
      if (known == candidate.end()) {
        candidate.push_back(c);
        put(candidates_[at(c)], tables);
      }
      tables.serves.push_back({number, {}, bound_[s]});
    }
    set_claims(tables, app_, platform_);
    return tables;
  }

  /// Whether each change has a worst case, as far as there is time to know.
  [[nodiscard]] bool claims_all(const TableChoice& choice) const {
    std::vector<int> candidate;
    Tables tables = tables_of(choice, candidate);
    return set_handovers(tables, -1, run_.until_after(options_.time_limit_s * kForClaimed)) &&
           cost_of(tables.handovers, tables, app_).unclaimed == 0;
  }

  /// Handovers of `table` from and to all others, the rest as before; all of them for -1.
  Status set_handovers(Tables& tables, int table, const Until& until) const {
    if (app_.one_at_a_time) {
      tables.handovers = releases_across(tables, app_, platform_);
      return {};
    }
    XAUTO_ASSIGN(const Changes changes, Changes::create(tables, app_, platform_));
    std::vector<Handover> all;
    const auto n = static_cast<int>(tables.tables.size());
    for (int from = 0; from < n; ++from)
      for (int to = 0; to < n; ++to) {
        if (from == to) continue;
        if (table >= 0 && from != table && to != table) {
          all.push_back(*handover_of(tables, from, to));
          continue;
        }
        XAUTO_ASSIGN(Handover handover, changes.between(from, to, until));
        all.push_back(std::move(handover));
      }
    tables.handovers = std::move(all);
    return {};
  }

  /// One of the tables in other keys, for the same scenarios.
  struct Trial {
    int table;
    int from;  ///< whose policy the search begins with
    How how;
    std::uint64_t seed;
    std::optional<KeyTable> found = {};
    Tables tables = {};  ///< with it, and with handovers
    ChangeCost cost = {};
  };

  /// Of equal tables many policies are as good, and only their changes differ. So each table in turn is
  /// searched again, from what the others do and from itself; what makes changes cheaper is taken.
  Result<Tables> with_cheap_changes(TableChoice choice) {
    const std::vector<double> regret_before = regrets_of(choice);
    merge(choice, regret_before);
    std::vector<int> candidate;
    Tables best = tables_of(choice, candidate);
    const Until no_limit{TimePoint::max(), options_.stop};
    XAUTO_TRY(set_handovers(best, -1, no_limit));
    const auto n = static_cast<int>(candidate.size());
    if (n < 2 || app_.one_at_a_time) return best;
    ChangeCost cost = cost_of(best.handovers, best, app_);
    const double slice =
        std::max(kLeastForTableS, (options_.time_limit_s - run_.elapsed()) / kSlicesForChanges);
    for (int round = 0; options_.max_evaluations == 0 || round < kChangeRounds * n; ++round) {
      // What has not settled does so where there is time to spare.
      How how;
      if (cost.unclaimed > 0 && round / n % 2 == 0) how.slack_pct = kSlackPct;
      std::vector<Trial> trials = next_trials(round % n, candidate, how);
      if (!fit(trials.size(), slice)) break;
      run_.on_threads(trials.size(),
                      [&](std::size_t k) { play(trials[k], choice, candidate, best, slice); });
      const Trial* cheapest = nullptr;
      for (const Trial& trial : trials)
        if (trial.found && trial.cost < cost &&
            allowed(*trial.found, choice, candidate[at(trial.table)], regret_before,
                    trial.cost.unclaimed < cost.unclaimed || trial.cost.missed < cost.missed) &&
            (cheapest == nullptr || trial.cost < cheapest->cost))
          cheapest = &trial;
      if (cheapest == nullptr) continue;
      take(*cheapest->found, at(cheapest->table), choice, candidate);
      best = cheapest->tables;
      cost = cheapest->cost;
    }
    return best;
  }

  /// In the place of table `t`'s.
  void take(KeyTable found, std::size_t t, TableChoice& choice, std::vector<int>& candidate) {
    const int was = candidate[t];
    const auto now = static_cast<int>(candidates_.size());
    candidates_.push_back(std::move(found));
    candidate[t] = now;
    std::replace(choice.chosen.begin(), choice.chosen.end(), was, now);
    std::replace(choice.serves.begin(), choice.serves.end(), was, now);
  }

  [[nodiscard]] std::vector<double> regrets_of(const TableChoice& choice) const {
    std::vector<double> regret;
    for (std::size_t s = 0; s < scenarios_.size(); ++s)
      regret.push_back(candidates_[at(choice.serves[s])].regret[s]);
    return regret;
  }

  /// Of one table: from each other one, with its placement and without, and from itself.
  [[nodiscard]] std::vector<Trial> next_trials(int table, const std::vector<int>& candidate,
                                               How how) {
    std::vector<Trial> trials;
    for (const int from : candidate)
      for (const Keep keep : {Keep::kPlacement, Keep::kNothing})
        if (candidates_[at(from)].loss == candidates_[at(candidate[at(table)])].loss) {
          how.keep = keep;
          trials.push_back({table, from, how, random_.next()});
        }
    return trials;
  }

  /// Another policy for the scenarios that candidate `replaced` serves, searched from candidate `from` on.
  [[nodiscard]] std::optional<KeyTable> search_from(const TableChoice& choice, int replaced,
                                                    int from, const How& how, std::uint64_t seed,
                                                    double slice) const {
    std::vector<int> group;
    for (std::size_t s = 0; s < scenarios_.size(); ++s)
      if (choice.serves[s] == replaced) group.push_back(static_cast<int>(s));
    const Scenario envelope = join(group);
    const std::size_t loss = candidates_[at(replaced)].loss;
    const Policy hint = hint_for(candidates_[at(from)], envelope);
    How as_before = how;
    as_before.together = is_together(candidates_[at(replaced)]);
    const auto answer = solve_for(envelope, losses_[loss], slice, 1, seed, &hint, as_before);
    if (!answer || answer->outcome != Outcome::kPolicy) return std::nullopt;
    KeyTable found = table_for(envelope, loss, answer->policy);
    rate(found);
    return found;
  }

  void play(Trial& trial, const TableChoice& choice, const std::vector<int>& candidate,
            const Tables& before, double slice) const {
    auto found =
        search_from(choice, candidate[at(trial.table)], trial.from, trial.how, trial.seed, slice);
    if (!found) return;
    Tables tables = before;
    replace(tables, trial.table, *found);
    if (!set_handovers(tables, trial.table, run_.until_after(kSlicesForHandovers * slice))) return;
    trial.cost = cost_of(tables.handovers, tables, app_);
    trial.tables = std::move(tables);
    trial.found = std::move(found);
  }

  /// What changes cost less for may cost this much regret, or none more. `before`: [scenario].
  [[nodiscard]] bool allowed(const KeyTable& table, const TableChoice& choice, int replaced,
                             const std::vector<double>& before, bool claims_more) const {
    const double factor = claims_more ? kMostForClaims : kMostForChanges;
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      if (choice.serves[s] != replaced) continue;
      const double most =
          std::max({factor * before[s], candidates_[at(replaced)].regret[s], run_.goal()});
      if (table.regret[s] > (options_.regret >= 1 ? std::min(most, options_.regret) : most))
        return false;
    }
    return true;
  }

  /// A table less needs no changes, where another one is nearly as good.
  void merge(TableChoice& choice, const std::vector<double>& before) const {
    for (std::size_t t = 0; t < choice.chosen.size();) {
      const int spared = choice.chosen[t];
      const auto other = std::find_if(choice.chosen.begin(), choice.chosen.end(), [&](int c) {
        return c != spared && allowed(candidates_[at(c)], choice, spared, before, false);
      });
      if (other == choice.chosen.end()) {
        ++t;
        continue;
      }
      std::replace(choice.serves.begin(), choice.serves.end(), spared, *other);
      choice.chosen.erase(choice.chosen.begin() + static_cast<std::ptrdiff_t>(t));
    }
  }

  void put(const KeyTable& candidate, Tables& tables) const {
    Table& table = tables.tables.emplace_back();
    table.loss = losses_[candidate.loss];
    table.name = name_of_table(tables.tables.size() - 1, table.loss, app_);
    fill(candidate, table);
  }
  /// The same scenarios, another policy.
  void replace(Tables& tables, int number, const KeyTable& candidate) const {
    Table& table = tables.tables[at(number)];
    table.keys = {};
    fill(candidate, table);
    for (Served& served : tables.serves) served.lower_bound_us = 0;  // of another chain, perhaps
    set_claims(tables, app_, platform_);
  }
  void fill(const KeyTable& candidate, Table& table) const {
    Policy& keys = table.keys;
    for (const Placement& p : hint_for(candidate, {}).placements)  // on the whole platform
      keys.placements.push_back({on_platform(p.xpu), p.key_us, p.hold_us});
    keys.order = candidate.policy.order;
    for (const ChainSpec& chain : app_.chains) keys.chains.push_back({chain.name, kNotThere});
    const std::vector<int> there = kept_chains(app_, table.loss);
    for (std::size_t k = 0; k < there.size(); ++k) {
      const ChainClaim& claim = candidate.policy.chains[k];
      keys.chains[at(there[k])] = {claim.name, claim.worst_case_us, 0, false,
                                   claim.urgent_worst_case_us};
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const std::vector<Scenario>& scenarios_;
  const TablesOptions& options_;
  const TablesRun run_;
  Random random_;
  /// XNode and XPU, where each clock has XPUs of its own; empty: they share.
  Forbids forbids_;
  std::vector<int> clock_of_;                     ///< [xnode] number of its domain
  std::vector<AppSpec> under_;                    ///< [scenario]
  std::vector<Loss> losses_{Loss{}};              ///< the first: nothing
  std::vector<std::size_t> loss_of_;              ///< [scenario] index into them
  std::vector<std::vector<std::int64_t>> bound_;  ///< [scenario][chain]
  std::vector<double> bound_value_;               ///< [scenario]
  std::vector<KeyTable> candidates_;
};

}  // namespace

Result<Tables> solve_key_tables(const AppSpec& app, const Platform& platform,
                                const Scenarios& scenarios, const TablesOptions& options) {
  return KeyTablesSearch(app, platform, scenarios, options).run();
}

}  // namespace xauto::solver::keys

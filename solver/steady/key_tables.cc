// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/key_tables.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "base/index.h"
#include "model/components.h"
#include "solver/random.h"
#include "solver/steady/handover.h"
#include "solver/steady/solve.h"
#include "solver/tables_run.h"

namespace xauto::solver::steady {
namespace {

/// Keys that are certified for an envelope.
struct KeyTable {
  Scenario of;                 ///< the envelope
  KeyPolicy policy;            ///< of that scenario's app and platform
  double value = 0;            ///< of its worst cases, what is compared
  std::vector<double> regret;  ///< [scenario]
};

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
    solve_all();
    TableChoice best = choose();
    constexpr int kRounds = 12;  // of a fixed number of evaluations each
    for (int round = 0; (options_.max_evaluations == 0 || round < kRounds) && !run_.over();
         ++round) {
      if (best.chosen.empty() || best.worst <= run_.goal()) break;
      improve(best);
      best = choose();
      run_.tell(bound_.size(), best.worst);
    }
    return answer(best);
  }

 private:
  [[nodiscard]] double value_of(const std::vector<std::int64_t>& us) const {
    const Objective of = chain_objective(app_, us);
    return of.chain >= 0 ? of.late : static_cast<double>(of.sum_us);
  }

  /// Where clocks share no XPU, and so a change has a worst case: for each type, how many of its XPUs
  /// each clock has. Nothing is split where that costs more than kMostForSplit, under the first
  /// scenario; the first such splits are tried, as many as there is time for.
  Status split_by_clock() {
    XAUTO_ASSIGN(const Components components, find_components(app_));
    const std::size_t clocks = components.domains.size();
    if (clocks < 2) return {};
    std::vector<int> clock_of;  // [xnode] index of its domain
    for (const int c : components.of) clock_of.push_back(components.components[at(c)].domain);
    std::vector<int> owner(platform_.xpus.size(), 0), best;
    const double slice = std::max(0.02, options_.time_limit_s / 200);
    const auto shared =
        solve_for(scenarios_.front(), 4 * slice, options_.threads, options_.seed, nullptr);
    if (!shared || shared->outcome != Outcome::kPolicy) return {};
    double most = kMostForSplit * value_of(worst_of(shared->policy));
    do {
      if (run_.elapsed() > options_.time_limit_s / 4) break;
      forbids_ = forbids_of(owner, clock_of);
      const auto answer =
          solve_for(scenarios_.front(), slice, options_.threads, options_.seed, nullptr);
      if (!answer || answer->outcome != Outcome::kPolicy) continue;
      const double value = value_of(worst_of(answer->policy));
      if (value > most) continue;
      most = value;
      best = owner;
    } while (next_split(owner, static_cast<int>(clocks)));
    forbids_.clear();
    if (!best.empty()) forbids_ = forbids_of(best, clock_of);
    return {};
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

  [[nodiscard]] std::vector<std::pair<std::string, std::string>> forbids_of(
      const std::vector<int>& owner, const std::vector<int>& clock_of) const {
    std::vector<std::pair<std::string, std::string>> forbids;
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
      for (std::size_t x = 0; x < owner.size(); ++x)
        if (owner[x] != clock_of[i])
          forbids.emplace_back(app_.xnodes[i].name, platform_.xpus[x].id);
    return forbids;
  }

  [[nodiscard]] static std::vector<std::int64_t> worst_of(const KeyPolicy& policy) {
    std::vector<std::int64_t> us;
    for (const ChainClaim& claim : policy.chains) us.push_back(claim.worst_case_us);
    return us;
  }

  [[nodiscard]] Result<Answer> solve_for(const Scenario& scenario, double seconds, int threads,
                                         std::uint64_t seed, const KeyPolicy* hint) const {
    Options solving;
    const Platform left = platform_under(platform_, scenario);
    for (const auto& [xnode, xpu] : forbids_)
      if (left.find(xpu) >= 0) solving.wishes.forbids.emplace_back(xnode, xpu);
    solving.time_limit_s = seconds;
    solving.threads = threads;
    solving.seed = seed;
    solving.max_evaluations = options_.max_evaluations;
    solving.stop = options_.stop;
    solving.hint = hint;
    return solve(app_under(app_, scenario), left, solving);
  }

  /// Half of the time, in equal shares of what is left of it.
  Status solve_each() {
    const std::size_t n = scenarios_.size();
    for (std::size_t s = 0; s < n; ++s) {
      const double share_s = run_.share_s(s);
      // Bounds are of all policies, also of those in which clocks share XPUs.
      std::optional<Answer> bounds;
      if (!forbids_.empty()) {
        const auto forbids = std::exchange(forbids_, {});
        auto all = solve_for(scenarios_[s], share_s / 4, options_.threads, options_.seed, nullptr);
        forbids_ = forbids;
        if (all) bounds = std::move(*all);
      }
      auto solved = solve_for(scenarios_[s], share_s, options_.threads, options_.seed + s, nullptr);
      // An XNode may have no XPU left that its clock has: then this scenario is served as it can be.
      if (bounds && (!solved || solved->outcome != Outcome::kPolicy)) solved = *bounds;
      XAUTO_ASSIGN(Answer answer, std::move(solved));
      if (bounds) answer.lower_bound_us = bounds->lower_bound_us;
      const std::string where = "scenario '" + scenarios_[s].name + "'";
      if (answer.outcome == Outcome::kUnsustainable)
        return fail(ErrorCode::kInfeasible, "no policy keeps up: " + answer.overload.text, where,
                    "less work, longer periods, or leave the scenario out");
      if (answer.outcome == Outcome::kUnknown)
        return fail(ErrorCode::kInfeasible,
                    "no policy was found in " + std::to_string(share_s) +
                        " s, and that there is none is not proven",
                    where, "more time: --time-limit-s");
      bound_.push_back(answer.lower_bound_us);
      bound_value_.push_back(std::max(1e-9, value_of(answer.lower_bound_us)));
      add(scenarios_[s], std::move(answer.policy));
      run_.tell(bound_.size(), kCannotServe);
    }
    for (KeyTable& table : candidates_) rate(table);
    return {};
  }

  /// A candidate that serves everything, where no scenario covers all others.
  void solve_all() {
    std::vector<int> all;
    for (std::size_t s = 0; s < scenarios_.size(); ++s) all.push_back(static_cast<int>(s));
    const Scenario envelope = join(all);
    if (known(envelope)) return;
    const auto answer =
        solve_for(envelope, std::max(0.1, (options_.time_limit_s - run_.elapsed()) / 10),
                  options_.threads, options_.seed, nullptr);
    if (!answer || answer->outcome != Outcome::kPolicy) return;
    add(envelope, answer->policy);
    rate(candidates_.back());
  }

  [[nodiscard]] Scenario join(const std::vector<int>& group) const {
    Scenario all = scenarios_[at(group.front())];
    for (std::size_t k = 1; k < group.size(); ++k)
      all = across(app_, all, scenarios_[at(group[k])]);
    return all;
  }
  [[nodiscard]] bool known(const Scenario& envelope) const {
    const AppSpec under = app_under(app_, envelope);
    return std::any_of(candidates_.begin(), candidates_.end(), [&](const KeyTable& table) {
      return covers(table.of, app_under(app_, table.of), envelope, under) &&
             covers(envelope, under, table.of, app_under(app_, table.of));
    });
  }

  void add(const Scenario& envelope, KeyPolicy policy) {
    KeyTable table{envelope, std::move(policy)};
    table.value = value_of(worst_of(table.policy));
    candidates_.push_back(std::move(table));
  }

  void rate(KeyTable& table) const {
    const AppSpec under = app_under(app_, table.of);
    table.regret.clear();
    for (std::size_t s = 0; s < scenarios_.size(); ++s)
      table.regret.push_back(covers(table.of, under, scenarios_[s], under_[s])
                                 ? table.value / bound_value_[s]
                                 : kCannotServe);
  }

  [[nodiscard]] TableChoice choose() const {
    std::vector<std::vector<double>> regret;
    for (const KeyTable& c : candidates_) regret.push_back(c.regret);
    return run_.choose(regret);
  }

  /// The policy of a candidate on the platform that is left under another envelope.
  [[nodiscard]] KeyPolicy hint_for(const KeyTable& table, const Scenario& envelope) const {
    const Platform had = platform_under(platform_, table.of),
                   has = platform_under(platform_, envelope);
    KeyPolicy hint = table.policy;
    for (KeyPlacement& p : hint.placements)
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
        if (c == choice.serves[s] || group.empty()) continue;
        group.push_back(static_cast<int>(s));
        if (known(join(group))) continue;
        tasks.push_back({std::move(group), c, random_.next()});
      }
    }
    const double slice = std::min(1.0, std::max(0.05, options_.time_limit_s - run_.elapsed()) *
                                           static_cast<double>(options_.threads) /
                                           static_cast<double>(tasks.size()));
    run_.on_threads(tasks.size(), [&](std::size_t k) {
      const Scenario envelope = join(tasks[k].group);
      const KeyPolicy hint = hint_for(candidates_[at(tasks[k].from)], envelope);
      const bool placed = std::any_of(hint.placements.begin(), hint.placements.end(),
                                      [](const KeyPlacement& p) { return p.xpu >= 0; });
      tasks[k].result = solve_for(envelope, slice, 1, tasks[k].seed, placed ? &hint : nullptr);
    });
    for (const Task& task : tasks) {
      if (!task.result || task.result->outcome != Outcome::kPolicy) continue;
      add(join(task.group), task.result->policy);
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
    Tables tables;
    tables.app = app_.name;
    tables.app_hash = app_.hash();
    tables.platform = platform_.name;
    tables.scenarios = scenarios_;
    tables.notice_us = kNoticeUs;
    std::vector<int> number(candidates_.size(), -1);
    for (std::size_t s = 0; s < scenarios_.size(); ++s) {
      const std::size_t c = at(choice.serves[s]);
      if (number[c] < 0) {
        number[c] = static_cast<int>(tables.tables.size());
        put(candidates_[c], tables);
      }
      tables.serves.push_back({number[c], 0, 0, bound_[s]});
    }
    set_priorities(tables);
    set_figures(tables, app_);
    XAUTO_TRY(add_handovers(tables));
    tables.solve_ms = static_cast<std::int64_t>(run_.elapsed() * 1000);
    return tables;
  }

  void put(const KeyTable& candidate, Tables& tables) const {
    Table& table = tables.tables.emplace_back();
    table.name = "table " + std::to_string(tables.tables.size() - 1);
    KeyPolicy& keys = tables.keys.emplace_back();
    for (const KeyPlacement& p : hint_for(candidate, {}).placements) {  // on the whole platform
      table.xpu.push_back(p.xpu);
      keys.placements.push_back({p.xpu, p.key_us, p.hold_us});
    }
    table.priority.assign(table.xpu.size(), 0);
    for (const ChainClaim& claim : candidate.policy.chains)
      keys.chains.push_back(
          {claim.name, claim.worst_case_us, 0, false, claim.urgent_worst_case_us});
  }

  Status add_handovers(Tables& tables) const {
    const std::size_t n = tables.tables.size();
    std::vector<Scenario> envelopes;
    std::vector<Problem> problems;
    std::vector<Windows> windows;
    for (std::size_t t = 0; t < n; ++t) {
      envelopes.push_back(envelope(tables, t, app_));
      XAUTO_ASSIGN(Problem problem, Problem::create(app_under(app_, envelopes[t]), platform_));
      XAUTO_ASSIGN(Windows of_table, windows_of(problem, tables.keys[t]));
      problems.push_back(std::move(problem));
      windows.push_back(std::move(of_table));
    }
    for (std::size_t from = 0; from < n; ++from)
      for (std::size_t to = 0; to < n; ++to) {
        if (from == to) continue;
        Handover& handover = tables.handovers.emplace_back();
        handover.from = static_cast<int>(from);
        handover.to = static_cast<int>(to);
        handover.worst_case_us.resize(app_.chains.size());
        if (needs_lost(tables.tables[from], platform_, envelopes[to])) {
          handover.not_claimed.emplace_back("it may need an XPU that is lost");
          continue;
        }
        XAUTO_ASSIGN(const Problem both,
                     Problem::create(app_under(app_, across(app_, envelopes[from], envelopes[to])),
                                     platform_));
        const HandoverBound bound = bound_handover(
            {problems[from], problems[to], both, tables.tables[from].xpu, tables.tables[to].xpu,
             windows[from], windows[to], tables.notice_us * both.scale},
            kMostWalked, {SteadyTime::max(), options_.stop});
        const auto up = [&](Tick t) { return both.up_to_us(t) / both.scale; };
        for (std::size_t c = 0; c < bound.worst.size(); ++c)
          if (bound.worst[c] != kNoTick) handover.worst_case_us[c] = up(bound.worst[c]);
        handover.settles_us = up(bound.settles);
        handover.not_claimed = bound.why_not;
      }
    return {};
  }

  [[nodiscard]] Result<Windows> windows_of(const Problem& p, const KeyPolicy& keys) const {
    Windows w;
    for (auto* values : {&w.a, &w.d, &w.hold, &w.e}) values->assign(at(p.num_slots), 0);
    std::vector<int> xpu;
    for (int i = 0; i < p.num_xnodes; ++i) {
      const KeyPlacement& placed = keys.placements[at(i)];
      xpu.push_back(placed.xpu);
      const std::size_t size = placed.key_us.size();
      for (int n = 0; n < p.jobs[at(i)]; ++n) {
        w.d[p.slot_of(i, n)] = placed.key_us[at(n) % size] * p.scale;
        if (!placed.hold_us.empty())
          w.hold[p.slot_of(i, n)] = placed.hold_us[at(n) % size] * p.scale;
      }
    }
    std::string why;
    if (!certify(p, xpu, w, &why))
      return fail(ErrorCode::kInternal, "a table does not hold for what it serves: " + why,
                  app_.name, "please report this");
    return w;
  }

  const AppSpec& app_;
  const Platform& platform_;
  const std::vector<Scenario>& scenarios_;
  const TablesOptions& options_;
  const TablesRun run_;
  Random random_;
  static constexpr double kMostForSplit = 1.15;
  /// XNode and XPU, where each clock has XPUs of its own; empty: they share.
  std::vector<std::pair<std::string, std::string>> forbids_;
  std::vector<AppSpec> under_;                    ///< [scenario]
  std::vector<std::vector<std::int64_t>> bound_;  ///< [scenario][chain]
  std::vector<double> bound_value_;               ///< [scenario]
  std::vector<KeyTable> candidates_;
};

}  // namespace

Result<Tables> solve_key_tables(const AppSpec& app, const Platform& platform,
                                const Scenarios& scenarios, const TablesOptions& options) {
  for (std::size_t s = 0; s < scenarios.list.size(); ++s)
    if (scenarios.list[s].degraded)
      return fail(ErrorCode::kInvalid, "is degraded: an app of version 2 loses nothing",
                  "/scenarios/" + std::to_string(s) + "/degraded", "leave it out");
  return KeyTablesSearch(app, platform, scenarios, options).run();
}

}  // namespace xauto::solver::steady

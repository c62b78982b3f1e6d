// SPDX-License-Identifier: Apache-2.0
#include "solver/tables.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "solver/choose_tables.h"
#include "solver/generate.h"
#include "solver/keys/check_tables.h"
#include "solver/simulate.h"
#include "solver/solve.h"

#include "problem_random.h"

namespace xauto::solver {
namespace {

AppSpec one_at_a_time() {
  AppSpec app;
  app.one_at_a_time = true;
  return app;
}

/// All of it hears of one camera.
void make_whole(AppSpec& app) {
  app.sources = {{"camera", kNoRate}};
  for (XNodeSpec& x : app.xnodes) x.sources = {0};
  for (const auto& [u, v] : app.edges) app.xnodes[static_cast<std::size_t>(v)].sources.clear();
  complete_modules(app);
  complete_chains(app);
}

struct ManyScenarios {
  AppSpec app = one_at_a_time();
  Platform platform = Platform::builtin("small").value();
  Scenarios scenarios;
};

ManyScenarios under_scenarios(int nodes, std::uint64_t seed) {
  GenerateOptions options;
  options.nodes = nodes;
  options.seed = seed;
  ManyScenarios c;
  c.app = generate(options).value();
  c.scenarios.app = c.app.name;
  for (const int gpu : {100, 200})
    for (const int cpu : {100, 150})
      c.scenarios.list.push_back({"gpu " + std::to_string(gpu) + " cpu " + std::to_string(cpu),
                                  {{"gpu", gpu}, {"cpu", cpu}}});
  c.scenarios.list.push_back({"no dla", {}, {}, {"dla0"}});
  return c;
}

TablesOptions tables_budget(int tables) {
  TablesOptions options;
  options.tables = tables;
  options.time_limit_s = 1e9;
  options.max_evaluations = 400;
  return options;
}

/// Who goes where, and first, by a table.
Decision decision_of(const ManyScenarios& c, const Tables& tables, std::size_t table) {
  const PriorityPlan plan = whole_policy(tables, table, c.app, c.platform);
  Decision decision;
  for (const PriorityPlacement& placed : plan.placements) {
    decision.xpu.push_back(placed.xpu);
    decision.priority.push_back(placed.priority);
  }
  decision.order = plan.order;
  return decision;
}

bool truthful(const ManyScenarios& c, const Tables& tables) {
  return keys::examine_tables(c.app, c.platform, tables).truthful();
}

bool uses(const Table& table, int xpu) {
  return std::ranges::any_of(table.keys.placements,
                             [&](const Placement& placed) { return placed.xpu == xpu; });
}

/// Its own arithmetic of a scenario: WCETs from the app's, an XPU's order from the table's pairs.
Time longest_under(test::Dice& dice, const ManyScenarios& c, const Tables& tables, std::size_t s) {
  const Scenario& scenario = tables.scenarios[s];
  const Problem problem = Problem::create(c.app, c.platform).value();
  const Decision decision =
      decision_of(c, tables, static_cast<std::size_t>(tables.serves[s].table));
  Time longest = 0;
  for (int k = 0; k < 60; ++k) {
    std::vector<Time> actual;
    for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
      const std::string& type = c.platform.xpus[static_cast<std::size_t>(decision.xpu[i])].type;
      const double pct = scenario.wcet_scale_pct.contains(type)
                             ? static_cast<double>(scenario.wcet_scale_pct.find(type)->second)
                             : 100.0;
      const auto wcet = static_cast<int>(
          std::ceil(static_cast<double>(*c.app.xnodes[i].wcet_on(type)) * pct / 100 - 1e-9));
      actual.push_back(k == 0 ? wcet : dice.chance(70) ? wcet : dice.roll(0, wcet));
    }
    longest = std::max(longest, simulate(problem, decision, {.actual = actual}).makespan);
  }
  return longest;
}

TEST(Tables, NoExecutionIsLongerThanItsScenarioSays) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    const ManyScenarios c = under_scenarios(12, seed);
    const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2));
    ASSERT_TRUE(tables) << tables.error().to_string();
    ASSERT_LE(tables->tables.size(), 2u);
    test::Dice dice(seed);
    for (std::size_t s = 0; s < c.scenarios.list.size(); ++s) {
      const Served& served = tables->serves[s];
      EXPECT_EQ(longest_under(dice, c, *tables, s), served.worst_case_us)
          << "at WCET it takes that long, and never longer";
      EXPECT_LE(served.lower_bound_us, served.worst_case_us);
      const Table& table = tables->tables[static_cast<std::size_t>(served.table)];
      if (!c.scenarios.list[s].lost.empty()) {
        EXPECT_FALSE(uses(table, c.platform.find("dla0")));
      }
    }
    const keys::TablesReport v = keys::examine_tables(c.app, c.platform, *tables);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
    EXPECT_DOUBLE_EQ(v.worst_regret, tables->worst_regret());
  }
}

TEST(Tables, MoreTablesServeNoWorseAndOneEachIsTheBestOfEach) {
  int better = 0;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const ManyScenarios c = under_scenarios(14, 40 + seed);
    double before = 1e9;
    for (const int k : {1, 2, 5}) {
      // Only what serves every scenario can serve alone.
      const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(k));
      ASSERT_TRUE(tables) << tables.error().to_string();
      EXPECT_LE(tables->worst_regret(), before + 1e-9) << "seed " << seed << ", " << k;
      better += tables->worst_regret() < before - 1e-9 && k > 1;
      before = tables->worst_regret();
    }
  }
  EXPECT_GT(better, 4);
}

TEST(Tables, TheFewestWithinARegret) {
  const ManyScenarios c = under_scenarios(14, 3);
  TablesOptions options = tables_budget(0);
  options.regret = 1.25;
  const auto few = solve_tables(c.app, c.platform, c.scenarios, options);
  ASSERT_TRUE(few) << few.error().to_string();
  EXPECT_LE(few->worst_regret(), 1.25);
  if (few->tables.size() > 1) {
    TablesOptions fewer = tables_budget(static_cast<int>(few->tables.size()) - 1);
    fewer.regret = 1.25;
    const auto none = solve_tables(c.app, c.platform, c.scenarios, fewer);
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().code, ErrorCode::kInfeasible);
  }
}

/// [assignment and order][scenario] how long it takes, by the simulator: priorities and run-time order of
/// each permutation of the XNodes.
std::vector<std::vector<Time>> every_table(const ManyScenarios& c) {
  const Problem whole = Problem::create(c.app, c.platform).value();
  const std::size_t n = c.app.xnodes.size();
  std::vector<std::vector<Time>> all;
  std::vector<int> sequence(n);
  for (std::size_t i = 0; i < n; ++i) sequence[i] = static_cast<int>(i);
  do {
    std::vector<Time> place(n);
    for (std::size_t k = 0; k < n; ++k)
      place[static_cast<std::size_t>(sequence[k])] = static_cast<Time>(k);
    if (std::any_of(c.app.edges.begin(), c.app.edges.end(), [&](const auto& edge) {
          return place[static_cast<std::size_t>(edge.first)] >
                 place[static_cast<std::size_t>(edge.second)];
        }))
      continue;
    std::vector<int> xpu(n, 0);
    for (std::size_t i = 0; i < n;) {
      bool runs = true;
      for (std::size_t k = 0; k < n; ++k)
        runs = runs && whole.wcet_on(static_cast<int>(k), xpu[k]) != kCannotRun;
      if (runs) {
        std::vector<Time>& took = all.emplace_back();
        for (const Scenario& scenario : c.scenarios.list) {
          // The longest path: in the sequence, after predecessors and after who has the XPU before.
          std::vector<Time> end(n, 0), free(c.platform.xpus.size(), 0);
          Time last = 0;
          for (const int x : sequence) {
            const auto i_x = static_cast<std::size_t>(x), m = static_cast<std::size_t>(xpu[i_x]);
            const std::string& type = c.platform.xpus[m].type;
            const auto pct = scenario.wcet_scale_pct.find(type);
            const Time wcet = *c.app.xnodes[i_x].wcet_on(type);
            Time start = free[m];
            for (const auto& [u, v] : c.app.edges)
              if (v == x) start = std::max(start, end[static_cast<std::size_t>(u)]);
            end[i_x] = free[m] =
                start +
                (pct == scenario.wcet_scale_pct.end() ? wcet : (wcet * pct->second + 99) / 100);
            last = std::max(last, end[i_x]);
          }
          const bool lost = std::any_of(xpu.begin(), xpu.end(), [&](int m) {
            return std::ranges::count(scenario.lost,
                                      c.platform.xpus[static_cast<std::size_t>(m)].id) > 0;
          });
          took.push_back(lost ? Time{1} << 50 : last);
        }
      }
      for (i = 0; i < n && ++xpu[i] == static_cast<int>(c.platform.xpus.size()); ++i) xpu[i] = 0;
    }
  } while (std::next_permutation(sequence.begin(), sequence.end()));
  return all;
}

/// Nets for GPU or DLA under power modes, enumerated: the worst of the scenarios' makespans over their
/// bounds is the least of any one table, and of any two.
TEST(Tables, OfASmallAppNoOthersAreBetter) {
  test::Dice dice(5);
  int mattered = 0;
  for (int round = 0; round < 30; ++round) {
    ManyScenarios c;
    c.platform.xpus = {
        {"cpu0", "cpu", true, 0}, {"gpu0", "gpu", true, 0}, {"dla0", "dla", true, 0}};
    c.app.name = c.scenarios.app = "nets";
    const int nets = dice.roll(2, 4);
    for (int i = 0; i < nets; ++i)
      c.app.xnodes.push_back({test::numbered("net", i),
                              test::numbered("m", i),
                              {{"gpu", dice.roll(2, 9)}, {"dla", dice.roll(4, 20)}}});
    c.app.xnodes.push_back({"fuse", "f", {{"cpu", 3}}});
    for (int i = 0; i < nets; ++i)
      if (dice.chance(80)) c.app.edges.emplace_back(i, nets);
    make_whole(c.app);
    c.scenarios.list = {{"a", {}}, {"b", {{"gpu", 310}, {"dla", 150}, {"cpu", 180}}}};
    if (dice.chance(50)) c.scenarios.list.push_back({"c", {{"gpu", 170}}, {}, {}});
    const auto all = every_table(c);
    for (const int k : {1, 2}) {
      bool tried_all = false;
      TablesOptions options = tables_budget(k);
      options.tried_all = &tried_all;
      const auto tables = solve_tables(c.app, c.platform, c.scenarios, options);
      ASSERT_TRUE(tables) << tables.error().to_string();
      EXPECT_TRUE(tried_all);
      double least = 1e9, first = 1e9;
      for (std::size_t a = 0; a < all.size(); ++a)
        for (std::size_t b = k == 1 ? a : 0; b <= a; ++b) {
          double worst = 0;
          for (std::size_t s = 0; s < c.scenarios.list.size(); ++s)
            worst = std::max(worst, static_cast<double>(std::min(all[a][s], all[b][s])) /
                                        static_cast<double>(tables->serves[s].lower_bound_us));
          least = std::min(least, worst);
        }
      first = tables->worst_regret();
      EXPECT_NEAR(first, least, 1e-9) << "round " << round << ", " << k << " tables";
      mattered += k == 1 && least > 1.001;
    }
  }
  EXPECT_GT(mattered, 5);
}

TEST(Tables, TheAnswerOfABudgetIsTheSameEveryTime) {
  const ManyScenarios c = under_scenarios(12, 9);
  TablesOptions options = tables_budget(2);
  auto first = solve_tables(c.app, c.platform, c.scenarios, options);
  options.threads = 1;
  auto second = solve_tables(c.app, c.platform, c.scenarios, options);
  ASSERT_TRUE(first && second);
  first->solve_us = second->solve_us = 0;
  EXPECT_EQ(*first, *second);
}

TEST(Tables, WhatMovesHasToBeWorthIt) {
  // Two scenarios; candidates 0 and 1 are the best of each, 2 is nearly as good as 1 and moves nothing.
  const std::vector<std::vector<double>> regret = {
      {1, kCannotServe}, {kCannotServe, 1.1}, {1.3, 1.1002}, {1.3, 1.2}};
  const std::vector<std::vector<int>> xpu = {{0, 1, 2}, {1, 0, 2}, {0, 1, 2}, {0, 1, 2}};
  const TableChoice best = choose_tables(regret, 2, 0, nullptr);
  ASSERT_EQ(best.serves, (std::vector<int>{0, 1}));
  const TableChoice fewer = fewer_instances(regret, xpu, best, 0);
  EXPECT_EQ(fewer.serves, (std::vector<int>{0, 2}));
  EXPECT_DOUBLE_EQ(fewer.worst, 1.1002);
  // Two instances are not worth a tenth of a regret.
  EXPECT_EQ(
      fewer_instances({regret[0], regret[1], {1.3, 1.2}}, {xpu[0], xpu[1], xpu[3]}, best, 0).serves,
      best.serves);
  // What was asked for is good enough.
  EXPECT_EQ(fewer_instances({regret[0], regret[1], {1.3, 1.2}}, {xpu[0], xpu[1], xpu[3]}, best, 1.2)
                .serves,
            (std::vector<int>{0, 2}));
  EXPECT_TRUE(fewer_instances(regret, xpu, TableChoice(), 0).chosen.empty());
}

TEST(Tables, AScenarioThatCannotRunIsNamed) {
  ManyScenarios c = under_scenarios(12, 5);
  c.scenarios.list.push_back({"no core", {}, {}, {"cpu0", "cpu1", "cpu2", "cpu3"}});
  const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2));
  if (tables) GTEST_SKIP() << "this app runs without cores";
  EXPECT_EQ(tables.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(tables.error().what.find("'no core'"), std::string::npos);
  EXPECT_EQ(tables.error().where, "/scenarios/5");
}

TEST(Tables, DifferentXpusLostNeedATableEach) {
  ManyScenarios c;
  c.app.name = "two";
  c.app.xnodes = {{"x", "X", {{"cpu", 5}, {"gpu", 3}}}};
  make_whole(c.app);
  c.platform = {"p", {{"cpu0", "cpu"}, {"gpu0", "gpu"}}};
  c.scenarios = {"two", {{"no gpu", {}, {}, {"gpu0"}}, {"no cpu", {}, {}, {"cpu0"}}}};
  const auto one = solve_tables(c.app, c.platform, c.scenarios, tables_budget(1));
  ASSERT_FALSE(one);
  EXPECT_EQ(one.error().code, ErrorCode::kInfeasible);
  const auto two = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2));
  ASSERT_TRUE(two) << two.error().to_string();
  EXPECT_EQ(two->serves[0], (Served{0, {5}, {5}, 5, 5}));
  EXPECT_EQ(two->serves[1], (Served{1, {3}, {3}, 3, 3}));
  EXPECT_EQ(two->worst_regret(), 1);
}

/// Each job takes the WCET of one of the two scenarios, or less; the change comes at any moment.
TEST(Tables, AReleaseThatSpansAChangeEndsInTime) {
  int longer = 0, none = 0, own = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    ManyScenarios c = under_scenarios(12, 70 + seed);
    c.scenarios.list.push_back({"dla slow", {{"dla", 180}}});
    const Tables tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(3)).value();
    const std::size_t n = tables.tables.size();
    ASSERT_EQ(tables.handovers.size(), n * (n - 1));
    const Problem problem = Problem::create(c.app, c.platform).value();
    test::Dice dice(seed);
    const auto longest_of = [&](const std::vector<std::int64_t>& us) {
      return *std::ranges::max_element(us);
    };
    for (std::size_t from = 0; from < tables.scenarios.size(); ++from)
      for (std::size_t to = 0; to < tables.scenarios.size(); ++to) {
        const int table = tables.serves[from].table, next = tables.serves[to].table;
        std::int64_t claim = 0;
        if (table == next) {
          for (const ChainClaim& chain : tables.tables[static_cast<std::size_t>(table)].keys.chains)
            claim = std::max(claim, chain.worst_case_us);
          own += claim > longest_of(tables.serves[from].chain_worst_us);
        } else {
          const Handover& change = *handover_of(tables, table, next);
          EXPECT_EQ(change.settles_us, 0);
          if (!change.claims_all()) {
            EXPECT_TRUE(
                uses(tables.tables[static_cast<std::size_t>(table)], c.platform.find("dla0")));
            ++none;
            continue;
          }
          for (const auto& us : change.worst_case_us) claim = std::max(claim, *us);
        }
        longer +=
            claim > std::max(tables.serves[from].worst_case_us, tables.serves[to].worst_case_us);
        const Decision decision = decision_of(c, tables, static_cast<std::size_t>(table));
        for (int k = 0; k < 20; ++k) {
          std::vector<Time> actual;
          for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
            const std::string& type =
                c.platform.xpus[static_cast<std::size_t>(decision.xpu[i])].type;
            const Scenario& now = tables.scenarios[dice.chance(50) ? from : to];
            const auto wcet = static_cast<int>(*app_under(c.app, now).xnodes[i].wcet_on(type));
            actual.push_back(dice.chance(80) ? wcet : dice.roll(0, wcet));
          }
          ASSERT_LE(simulate(problem, decision, {.actual = actual}).makespan, claim);
        }
      }
    EXPECT_TRUE(truthful(c, tables));
    for (Tables bad = tables; Handover & change : bad.handovers) {
      if (!change.claims_all()) continue;
      auto longest = std::ranges::max_element(change.worst_case_us);
      --**longest;
      EXPECT_FALSE(truthful(c, bad));
      break;
    }
  }
  EXPECT_GT(longer, 10) << "the larger of both worst cases would not do";
  EXPECT_GT(none, 10);
  EXPECT_GT(own, 10) << "a scenario has less than its table";
}

void keep_time(ManyScenarios& c, std::optional<std::int64_t> us) {
  for (ChainSpec& chain : c.app.chains) chain.deadline_us = us;
}

/// Variants of half of the work for every second XNode, and optional modules where nobody waits; a
/// deadline that the slowest scenario does not keep without.
ManyScenarios with_losses(std::uint64_t seed) {
  ManyScenarios c = under_scenarios(12, seed);
  const auto succ = c.app.successors();
  c.app.modules.clear();
  int optional = 0;
  for (std::size_t i = 0; i < c.app.xnodes.size(); ++i) {
    XNodeSpec& x = c.app.xnodes[i];
    x.module = "m" + std::to_string(i);
    if (i % 2 == 0) {
      VariantSpec half{"half", 70};
      for (const auto& [type, us] : x.wcet_us) half.wcet_us[type] = (us + 1) / 2;
      x.variants = {half};
    } else if (succ[i].empty() && ++optional < 3) {
      c.app.modules.push_back({x.module, 1, true});
    }
  }
  complete_modules(c.app);
  c.app.chains.clear();
  complete_chains(c.app);
  c.scenarios.list = {
      {"nominal"}, {"slow", {{"gpu", 180}, {"cpu", 150}}}, {"no dla", {}, {}, {"dla0"}}};
  SolveOptions options;
  options.ordered_only = true;
  options.time_limit_s = 1e9;
  options.max_evaluations = 2000;
  const PriorityPlan slow =
      solve(app_under(c.app, c.scenarios.list[1]), c.platform, options).value();
  keep_time(c, slow.lower_bound_us * 85 / 100);
  return c;
}

/// WCETs by its own arithmetic; the order from the table's pairs.
Time at_wcets(const ManyScenarios& c, const Tables& tables, std::size_t s) {
  const Table& table = tables.tables[static_cast<std::size_t>(tables.serves[s].table)];
  AppSpec app = c.app;
  app.modules.clear();
  app.chains.clear();
  std::vector<Time> actual;
  Decision decision = decision_of(c, tables, static_cast<std::size_t>(tables.serves[s].table));
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    XNodeSpec& x = app.xnodes[i];
    const bool off = std::count(table.loss.off.begin(), table.loss.off.end(), x.module) > 0;
    if (off) {  // takes nothing, on a CPU, after all others
      decision.xpu[i] = c.platform.find("cpu0");
      decision.priority[i] = -1'000'000 - static_cast<int>(i);
      x.wcet_us["cpu"] = 1;
      actual.push_back(0);
      continue;
    }
    const std::string& type = c.platform.xpus[static_cast<std::size_t>(decision.xpu[i])].type;
    Time us = *x.wcet_on(type);
    if (!table.loss.variant.empty() && table.loss.variant[i] == 0) us = (us + 1) / 2;
    const auto scale = tables.scenarios[s].wcet_scale_pct.find(type);
    if (scale != tables.scenarios[s].wcet_scale_pct.end()) us = (us * scale->second + 99) / 100;
    actual.push_back(us);
    x.wcet_us[type] = std::max(us, *x.wcet_on(type));
  }
  const Problem problem = Problem::create(app, c.platform).value();
  return simulate(problem, decision, {.actual = actual}).makespan;
}

TEST(Tables, WhereItIsDegradedTheAppLosesWhatItMustAndNowhereElse) {
  int kept_by_loss = 0, all_lost = 0;
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    ManyScenarios c = with_losses(90 + seed);
    const auto plain = solve_tables(c.app, c.platform, c.scenarios, tables_budget(3));
    ASSERT_TRUE(plain) << plain.error().to_string();
    for (const Table& table : plain->tables) EXPECT_TRUE(table.loss.none()) << "nobody allowed it";
    EXPECT_GT(plain->serves[1].worst_case_us, *c.app.chains[0].deadline_us);
    c.scenarios.list[1].degraded = true;
    const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(3));
    ASSERT_TRUE(tables) << tables.error().to_string();
    for (const std::size_t s : {0, 2})
      EXPECT_TRUE(tables->tables[static_cast<std::size_t>(tables->serves[s].table)].loss.none());
    const Table& less = tables->tables[static_cast<std::size_t>(tables->serves[1].table)];
    EXPECT_FALSE(less.loss.none());
    EXPECT_NE(less.name.find(words_of(less.loss, c.app)), std::string::npos) << less.name;
    if (tables->serves[1].worst_case_us <= *c.app.chains[0].deadline_us)
      ++kept_by_loss;
    else
      ++all_lost;
    for (std::size_t s = 0; s < 3; ++s)
      EXPECT_EQ(at_wcets(c, *tables, s), tables->serves[s].worst_case_us) << seed << ", " << s;
    const keys::TablesReport v = keys::examine_tables(c.app, c.platform, *tables);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
    const auto lies = [&](const auto& spoil) {
      Tables bad = *tables;
      spoil(bad, bad.tables[static_cast<std::size_t>(bad.serves[1].table)]);
      return !truthful(c, bad);
    };
    EXPECT_TRUE(lies([](Tables& t, Table&) { t.scenarios[1].degraded = false; }));
    EXPECT_TRUE(lies([](Tables& t, Table&) {
      std::int64_t& longest = *std::ranges::max_element(t.serves[1].chain_worst_us);
      --longest;
    }));
    EXPECT_TRUE(lies([](Tables& t, Table&) { t.serves[0].table = t.serves[1].table; }));
    EXPECT_TRUE(lies([](Tables&, Table& table) {
      table.loss.off.clear();
      table.loss.variant.clear();
    })) << "what it claims is of less work";
    EXPECT_TRUE(lies([](Tables&, Table& table) { table.loss.off = {"m0"}; })) << "is needed";
  }
  EXPECT_GT(kept_by_loss, 6);
  EXPECT_LT(all_lost, 6);
}

/// An XNode whose XPU is gone is off where its module may be.
TEST(Tables, WhatCanRunNowhereIsOffWhereItMayBe) {
  ManyScenarios c;
  std::string optional;
  for (std::uint64_t seed = 91; optional.empty() && seed < 191; ++seed) {
    c = with_losses(seed);
    for (const ModuleSpec& module : c.app.modules)
      if (module.optional) optional = module.name;
  }
  ASSERT_FALSE(optional.empty());
  for (XNodeSpec& x : c.app.xnodes) {
    if (x.module == optional) x.wcet_us = {{"dla", 2000}};
    if (x.module == optional) x.variants.clear();
    if (x.module != optional) x.wcet_us.emplace("cpu", 9000);
  }
  c.scenarios.list = {{"nominal"}, {"no DLA", {}, {}, {"dla0"}}};
  EXPECT_FALSE(solve_tables(c.app, c.platform, c.scenarios, tables_budget(2)));
  c.scenarios.list[1].degraded = true;
  const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2));
  ASSERT_TRUE(tables) << tables.error().to_string();
  EXPECT_TRUE(
      tables->tables[static_cast<std::size_t>(tables->serves[1].table)].loss.is_off(optional));
  const keys::TablesReport v = keys::examine_tables(c.app, c.platform, *tables);
  EXPECT_TRUE(v.truthful()) << v.lies.front();
}

/// A schedule that keeps no order is shorter sooner, and certifies nothing: it must not end the search.
TEST(Tables, NothingIsLostWhereACertifiedPolicyKeepsTheTime) {
  int shorter_without_order = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    ManyScenarios c = with_losses(200 + seed);
    c.scenarios.list.resize(2);
    c.scenarios.list[1].degraded = true;
    SolveOptions options;
    options.ordered_only = true;
    options.time_limit_s = 1e9;
    options.max_evaluations = 400;  // as tables_budget()
    options.seed = 2;               // of the second scenario
    const AppSpec slow = app_under(c.app, c.scenarios.list[1]);
    const Time certified_us = solve(slow, c.platform, options)->latency_us;
    keep_time(c, certified_us);
    options.ordered_only = false;
    shorter_without_order += solve(slow, c.platform, options)->latency_us < certified_us;
    const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2));
    ASSERT_TRUE(tables) << tables.error().to_string();
    for (const Table& table : tables->tables)
      EXPECT_TRUE(table.loss.none()) << seed << ": " << table.name;
  }
  EXPECT_GT(shorter_without_order, 1);
}

TEST(Tables, NothingSaysForWhatItWouldLose) {
  ManyScenarios c = with_losses(7);
  c.scenarios.list[1].degraded = true;
  keep_time(c, {});
  const auto tables = solve_tables(c.app, c.platform, c.scenarios, tables_budget(3));
  ASSERT_FALSE(tables);
  EXPECT_EQ(tables.error().where, "/scenarios/1/degraded");
  for (ChainSpec& chain : c.app.chains) chain.deadline_us = 100'000'000;
  EXPECT_TRUE(solve_tables(c.app, c.platform, c.scenarios, tables_budget(3)));
}

// How long a release takes does not say all then: each chain is planned by keys.
TEST(Tables, TransfersAndDeadlinesThatDifferArePlannedToo) {
  const ManyScenarios c = under_scenarios(6, 3);
  AppSpec moves = c.app, two = c.app;
  for (std::size_t e = 0; e < moves.edges.size(); ++e)
    for (const auto& [from, to] : {std::pair("cpu", "gpu"), {"gpu", "cpu"}})
      if (moves.xnodes[static_cast<std::size_t>(moves.edges[e].first)].wcet_on(from) &&
          moves.xnodes[static_cast<std::size_t>(moves.edges[e].second)].wcet_on(to))
        moves.transfers.push_back({static_cast<int>(e), from, to, 700});
  ASSERT_FALSE(moves.transfers.empty());
  for (ChainSpec& chain : two.chains) chain.deadline_us = 1'000'000;
  two.chains.push_back(two.chains.front());
  two.chains.back().name = "sooner";
  two.chains.back().deadline_us = 500'000;
  TablesOptions options = tables_budget(2);
  options.max_evaluations = 100;
  for (const AppSpec& app : {moves, two}) {
    ASSERT_TRUE(validate(app)) << validate(app).error().to_string();
    const auto made = solve_tables(app, c.platform, c.scenarios, options);
    ASSERT_TRUE(made) << made.error().to_string();
    const keys::TablesReport v = keys::examine_tables(app, c.platform, *made);
    EXPECT_TRUE(v.truthful()) << v.lies.front();
    for (const Handover& change : made->handovers) EXPECT_EQ(change.settles_us, 0);
    for (const Served& served : made->serves)
      EXPECT_EQ(served.lower_bound_us, bound_of_chains(served, app)) << "of the chain that is told";
  }
}

TEST(Tables, EachFalseNumberIsALie) {
  const ManyScenarios c = under_scenarios(12, 2);
  const Tables good = solve_tables(c.app, c.platform, c.scenarios, tables_budget(2)).value();
  const auto lies = [&](const Tables& tables) { return !truthful(c, tables); };
  EXPECT_FALSE(lies(good));
  const auto less_in = [](std::vector<std::int64_t>& us) { --*std::ranges::max_element(us); };
  for (std::size_t s = 0; s < good.serves.size(); ++s) {
    Tables bad = good;
    less_in(bad.serves[s].chain_worst_us);
    EXPECT_TRUE(lies(bad)) << "a worst case below its own execution";
    bad = good;
    bad.serves[s].lower_bound_us = bad.serves[s].worst_case_us + 1;
    EXPECT_TRUE(lies(bad)) << "a bound above a policy";
    for (const Served& other : good.serves)
      if (other.table == good.serves[s].table &&
          other.worst_case_us < good.serves[s].worst_case_us) {
        bad = good;
        bad.serves[s].chain_worst_us = other.chain_worst_us;
        EXPECT_TRUE(lies(bad)) << "copied from another scenario";
      }
  }
  for (std::size_t t = 0; t < good.tables.size(); ++t) {
    Tables bad = good;
    --std::ranges::max_element(bad.tables[t].keys.chains, {}, &ChainClaim::worst_case_us)
          ->worst_case_us;
    EXPECT_TRUE(lies(bad)) << "less than what it claims of its scenarios, or than its keys";
  }
  // Without its order a job may start before one that has a smaller key: nothing follows from the sequence then.
  Tables bare = good;
  for (Table& table : bare.tables) table.keys.order.clear();
  EXPECT_TRUE(lies(bare));
  Tables scaled = good;
  scaled.scenarios[0].wcet_scale_pct["gpu"] = 300;
  scaled.scenarios[0].wcet_scale_pct["cpu"] = 300;
  EXPECT_TRUE(lies(scaled)) << "claims of another scenario";
}

}  // namespace
}  // namespace xauto::solver

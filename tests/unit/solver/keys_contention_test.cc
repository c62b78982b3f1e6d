// SPDX-License-Identifier: Apache-2.0
// Contention (docs/keys.md): what is counted, by the check, by a second derivation here, by an attack, and on tiny apps
// by every execution that there is.
#include <algorithm>
#include <map>
#include <numeric>
#include <random>
#include <set>

#include <gtest/gtest.h>

#include "model/contention.h"
#include "model/early_start.h"
#include "model/json.h"
#include "solver/keys/check.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"

#include "attack/attack.h"
#include "attack/producer.h"

namespace xauto::solver::keys::test::contention {
namespace {

// ---- A public report: a GPU net of 45 ms, 51 beside one DLA and 59 beside two; DLA nets of 17.7 and 21.8 ms.

Platform soc() {
  return {"soc", {{"gpu0", "gpu", true, 0}, {"dla0", "dla", true, 0}, {"dla1", "dla", true, 0}}};
}

AppSpec report(std::int64_t dla_deadline_us, bool beside) {
  AppSpec app;
  app.name = "report";
  app.sources = {{"camera", {100'000, 1}}};
  app.xnodes = {{"detect", "detect", {{"gpu", 45'000}}, {0}},
                {"lane", "lane", {{"dla", 17'700}}, {0}},
                {"depth", "depth", {{"dla", 21'800}}, {0}}};
  if (beside) app.xnodes[0].beside = {{"gpu", {{"dla", 1}}, 51'000}, {"gpu", {{"dla", 2}}, 59'000}};
  for (const XNodeSpec& x : app.xnodes) app.modules.push_back({x.name, 1, false});
  app.chains = {{"detect", 0, 0, 50'000, 1},
                {"lane", 0, 1, dla_deadline_us, 1},
                {"depth", 0, 2, dla_deadline_us, 1}};
  return app;
}

Options brief() {
  Options options;
  options.time_limit_s = 60;
  options.max_evaluations = 4000;
  return options;
}

Answer solved(const AppSpec& app, const Platform& platform) {
  const auto answer = solve(app, platform, brief());
  EXPECT_TRUE(answer) << answer.error().to_string();
  EXPECT_EQ(answer->outcome, Outcome::kPolicy);
  const auto checked = check(app, platform, answer->policy);
  EXPECT_TRUE(checked) << checked.error().to_string();
  const auto read = parse_policy(to_json(answer->policy, app, platform), "policy", app, platform);
  EXPECT_TRUE(read) << read.error().to_string();
  return *answer;
}

TEST(KeysContention, FromTimesAloneTheReportsNetIsCertifiedAndItIsSaidWhatThatTakesForGranted) {
  const AppSpec app = report(30'000, false);
  const Answer answer = solved(app, soc());
  EXPECT_EQ(answer.policy.chains[0].worst_case_us, 45'000);
  EXPECT_FALSE(answer.policy.placements[0].wcet_us.has_value());
  const auto checked = check(app, soc(), answer.policy);
  ASSERT_TRUE(checked);
  EXPECT_TRUE(std::ranges::any_of(checked->taken, [](const std::string& taken) {
    return taken.starts_with("XPUs are independent") && taken.find("dla, gpu") != std::string::npos;
  }));
}

TEST(KeysContention, BesideItsLoadTheReportsNetMissesItsDeadlineWhereAllHaveToRunAtOnce) {
  const AppSpec app = report(40'000, true);
  const Answer answer = solved(app, soc());
  EXPECT_TRUE(misses_a_deadline(answer.policy, app));
  // Its keys of before, with the time alone, are a lie.
  Policy policy = solved(report(40'000, false), soc()).policy;
  policy.app_hash = app.hash();
  policy.placements[0].wcet_us = 45'000;
  const auto checked = check(app, soc(), policy);
  ASSERT_FALSE(checked);
  EXPECT_EQ(checked.error().code, ErrorCode::kInfeasible);
  EXPECT_NE(checked.error().what.find("it may run beside 2 dla, where it takes 59000 us"),
            std::string::npos)
      << checked.error().to_string();
}

TEST(KeysContention, WhereTheDlasMayWaitTheyArePlannedApart) {
  const AppSpec app = report(100'000, true);
  const Answer answer = solved(app, soc());
  EXPECT_FALSE(misses_a_deadline(answer.policy, app));
  EXPECT_EQ(answer.policy.placements[0].wcet_us, 45'000);
  const attack::Found found = attack::attack(app, soc(), answer.policy, {20'000, 1});
  EXPECT_FALSE(found.broken()) << found.late << found.chain;
  EXPECT_TRUE(
      attack::attack(app, soc(), answer.policy, {20'000, 1, attack::Early::kOfItsXpu}).broken())
      << "a DLA that starts early, whatever runs on the GPU";
  // Only what the plan keeps it apart from is waited for.
  const auto apart = kept_apart(app, soc(), answer.policy);
  EXPECT_EQ(apart[1], std::vector<int>{0});
  EXPECT_EQ(apart[0], (std::vector<int>{1, 2}));
}

TEST(KeysContention, BesideOneDlaItsTimeBesideOneCounts) {
  AppSpec app = report(100'000, true);
  app.chains[0].deadline_us = 55'000;
  app.chains[1].deadline_us = 25'000;  // beside it, whatever the plan
  const Answer answer = solved(app, soc());
  EXPECT_FALSE(misses_a_deadline(answer.policy, app));
  EXPECT_EQ(answer.policy.placements[0].wcet_us, 51'000);
}

TEST(KeysContention, BesideOtherAppsTheLongestCounts) {
  const AppSpec app = report(100'000, true);
  const Policy policy = solved(app, soc()).policy;
  const auto demand = demand_of(app, soc(), policy);
  ASSERT_FALSE(demand);
  EXPECT_NE(demand.error().what.find("beside other apps it may take 59000 us"), std::string::npos);
  EXPECT_FALSE(sporadic_needs_of(app, soc(), policy));
  EXPECT_FALSE(check(app, soc(), policy, {{}, 5}));
  Options options = brief();
  options.beside.reserve_pct = 5;
  const auto answer = solve(app, soc(), options);
  ASSERT_TRUE(answer);
  ASSERT_EQ(answer->outcome, Outcome::kPolicy);
  EXPECT_EQ(answer->policy.placements[0].wcet_us, 59'000);
  EXPECT_TRUE(check(app, soc(), answer->policy, {{}, 5}));
  EXPECT_TRUE(demand_of(app, soc(), answer->policy));
}

TEST(KeysContention, WhatIsNotStatedTogetherIsRefusedByName) {
  AppSpec app = report(100'000, true);
  app.xnodes[0].beside.pop_back();
  const auto answer = solve(app, soc(), brief());
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().code, ErrorCode::kInvalid);
  EXPECT_NE(answer.error().what.find("may run beside 2 dla, of which no time is stated"),
            std::string::npos)
      << answer.error().to_string();
  // With one net for DLAs there is no second load.
  app.xnodes[2].wcet_us = {{"gpu", 10'000}};
  app.chains.pop_back();
  EXPECT_TRUE(solve(app, soc(), brief()));
}

// ---- A second derivation of what is counted.

enum class Fault {
  kNone,
  kFast,             ///< what it takes alone, also where windows overlap
  kOtherClockApart,  ///< who has another clock is not met
  kCombination,      ///< of several loads at once the longest of each by itself
};

/// By windows of every activation of two hyperperiods, pair by pair.
class Second {
 public:
  Second(const attack::Case& c, Fault fault) : c_(c), fault_(fault), n_(c.app.xnodes.size()) {
    const auto parts = find_components(c.app);
    parts_ = *parts;
    lag_.assign(n_, std::vector<std::int64_t>(n_, kFar));
    for (std::size_t i = 0; i < n_; ++i) lag_[i][i] = 1;
    std::vector<char> inner(n_, 0);
    for (const auto& [u, v] : c.app.edges) {
      lag_[at(u)][at(v)] = 0;
      if (c.app.xnodes[at(u)].module == c.app.xnodes[at(v)].module) inner[at(v)] = 1;
    }
    for (const auto& [u, v] : c.policy.order) lag_[at(u)][at(v)] = 0;
    for (std::size_t u = 0; u < n_; ++u)
      for (std::size_t v = 0; v < n_; ++v)
        if (c.app.xnodes[u].module == c.app.xnodes[v].module && !inner[v])
          for (const ModuleSpec& m : c.app.modules)
            if (m.name == c.app.xnodes[u].module)
              lag_[u][v] = std::min(lag_[u][v], m.max_in_flight);
    for (std::size_t k = 0; k < n_; ++k)
      for (std::size_t u = 0; u < n_; ++u)
        for (std::size_t v = 0; v < n_; ++v)
          lag_[u][v] = std::min(lag_[u][v], lag_[u][k] + lag_[k][v]);
  }

  [[nodiscard]] std::vector<std::int64_t> counted() const {
    std::vector<std::int64_t> all;
    for (std::size_t i = 0; i < n_; ++i) {
      const std::string& on = type(i);
      std::map<std::string, std::int64_t, std::less<>> load;
      for (std::size_t m = 0; m < c_.platform.xpus.size(); ++m)
        for (std::size_t j = 0; j < n_; ++j)
          if (xpu(j) == static_cast<int>(m) && xpu(i) != xpu(j) && fault_ != Fault::kFast &&
              meet(i, j)) {
            ++load[c_.platform.xpus[m].type];
            break;
          }
      std::int64_t takes = 0;
      if (fault_ == Fault::kCombination)
        for (const auto& [type, count] : load)
          takes = std::max(takes, wcet_beside(c_.app.xnodes[i], on, {{type, 1}}).value());
      else
        takes = wcet_beside(c_.app.xnodes[i], on, load).value();
      all.push_back(std::max(takes, *c_.app.xnodes[i].wcet_on(on)));
    }
    return all;
  }

 private:
  static constexpr std::int64_t kFar = std::int64_t{1} << 40;
  [[nodiscard]] int xpu(std::size_t i) const { return c_.policy.placements[i].xpu; }
  [[nodiscard]] const std::string& type(std::size_t i) const {
    return c_.platform.xpus[at(xpu(i))].type;
  }
  [[nodiscard]] const xauto::Component& home(std::size_t i) const {
    return parts_.components[at(parts_.of[i])];
  }
  [[nodiscard]] std::int64_t release(std::size_t i, std::int64_t k) const {
    return home(i).offset_us + k * home(i).period.floor_us();
  }
  [[nodiscard]] std::int64_t entry(const std::vector<std::int64_t>& of, std::int64_t k) const {
    const auto size = static_cast<std::int64_t>(of.size());
    return of.empty() ? 0 : of[static_cast<std::size_t>(((k % size) + size) % size)];
  }
  [[nodiscard]] std::int64_t earliest(std::size_t i, std::int64_t k) const {
    std::int64_t e = entry(c_.policy.placements[i].hold_us, k);
    const std::int64_t ppm = c_.app.clocks[at(home(i).clock)].ppm;
    for (const int s : c_.app.xnodes[i].sources)
      e = std::max(
          e, (c_.app.sources[at(s)].offset_us - home(i).offset_us) * (1'000'000 - ppm) / 1'000'000);
    const auto transfers = transfers_us(c_.policy, c_.app, c_.platform);
    for (std::size_t edge = 0; edge < c_.app.edges.size(); ++edge)
      if (at(c_.app.edges[edge].second) == i)
        e = std::max(e, earliest(at(c_.app.edges[edge].first), k) + transfers[edge]);
    for (const auto& [u, v] : c_.policy.order)
      if (at(v) == i) e = std::max(e, earliest(at(u), k));
    return e;
  }
  [[nodiscard]] bool meet(std::size_t i, std::size_t j) const {
    if (home(i).clock != home(j).clock) return fault_ != Fault::kOtherClockApart;
    const std::int64_t ppm = c_.app.clocks[at(home(i).clock)].ppm;
    const std::int64_t period = home(i).period.floor_us(), other = home(j).period.floor_us();
    const auto sizes = [&](std::size_t x) {
      return static_cast<std::int64_t>(c_.policy.placements[x].key_us.size());
    };
    std::int64_t turn = std::lcm(period, other), deepest = 0;
    for (std::size_t x = 0; x < n_; ++x) {
      turn = std::lcm(turn, sizes(x) * home(x).period.floor_us());
      deepest = std::max(deepest, std::ranges::max(c_.policy.placements[x].key_us));
    }
    for (std::int64_t k = 0; k < turn / period; ++k)
      for (std::int64_t m = (release(i, k) - 2 * deepest) / other - 2;
           release(j, m) < release(i, k) + 2 * deepest; ++m) {
        if (m - k >= lag_[i][j] || k - m >= lag_[j][i]) continue;
        const std::int64_t apart = (release(j, m) - release(i, k));
        const std::int64_t one = apart * (1'000'000 - ppm), two = apart * (1'000'000 + ppm);
        const std::int64_t from =
            (earliest(i, k) - entry(c_.policy.placements[j].key_us, m)) * 1'000'000;
        const std::int64_t to =
            (entry(c_.policy.placements[i].key_us, k) - earliest(j, m)) * 1'000'000;
        if (std::min(one, two) < to && std::max(one, two) > from) return true;
      }
    return false;
  }

  const attack::Case& c_;
  Fault fault_;
  std::size_t n_;
  Components parts_;
  std::vector<std::vector<std::int64_t>>
      lag_;  ///< [u][v] least, so that v of n + lag waits for u of n
};

/// What a checker with the fault would accept. The case counts what that one does.
bool accepts(attack::Case& c, Fault fault) {
  const std::vector<std::int64_t> counted = Second(c, fault).counted();
  AppSpec app = c.app;
  for (std::size_t i = 0; i < counted.size(); ++i) {
    Placement& placed = c.policy.placements[i];
    const std::string& on = c.platform.xpus[at(placed.xpu)].type;
    placed.wcet_us.reset();
    if (!stated_loads(c.app.xnodes[i], on).empty()) placed.wcet_us = counted[i];
    app.xnodes[i].wcet_us[on] = counted[i];
    app.xnodes[i].beside.clear();
  }
  if (fault == Fault::kNone) return check(c.app, c.platform, c.policy).has_value();
  Policy policy = c.policy;
  for (Placement& placed : policy.placements) placed.wcet_us.reset();
  policy.app_hash = app.hash();
  return check(app, c.platform, policy).has_value();
}

attack::Wanted contended(std::uint64_t seed) {
  attack::Wanted w;
  w.clocks = seed % 3 == 0 ? 2 : 1;
  w.ppm = seed % 4 == 0 ? 1000 : 0;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.holds = true;
  w.order = seed % 5 == 0;
  w.preemptive = seed % 2 == 0;
  w.preempt_us = seed % 4 == 0 ? 0 : 20;
  w.load = 0.4;
  w.longest = 3;
  w.beside = true;
  return w;
}

TEST(KeysContention, TheCheckCountsWhatASecondDerivationCounts) {
  int made = 0, apart = 0, beside = 0;
  for (std::uint64_t seed = 1; seed <= 150; ++seed) {
    auto c = attack::valid(seed, contended(seed));
    if (!c) continue;
    ++made;
    ASSERT_TRUE(accepts(*c, Fault::kNone)) << seed;
    for (std::size_t i = 0; i < c->app.xnodes.size(); ++i) {
      Placement& placed = c->policy.placements[i];
      if (!placed.wcet_us) continue;
      const std::int64_t counted = *placed.wcet_us;
      const bool least =
          counted == *c->app.xnodes[i].wcet_on(c->platform.xpus[at(placed.xpu)].type);
      (least ? apart : beside) += 1;
      if (least || c->app.clocks.back().ppm > 0) continue;  // drift: rounded to longer
      placed.wcet_us = counted - 1;
      EXPECT_FALSE(check(c->app, c->platform, c->policy)) << seed << ": XNode " << i;
      placed.wcet_us = counted;
    }
  }
  EXPECT_GE(made, 100);
  EXPECT_GE(apart, 30);
  EXPECT_GE(beside, 100);
}

TEST(KeysContention, NoExecutionIsLaterThanTheCheckSaysAndFaultsAreFound) {
  const std::pair<Fault, const char*> wrong[] = {
      {Fault::kFast, "fast in an overlap"},
      {Fault::kOtherClockApart, "another clock is apart"},
      {Fault::kCombination, "one load at a time"}};
  std::map<Fault, int> broken;
  int made = 0, early = 0;
  for (std::uint64_t seed = 1; seed <= 90; ++seed) {
    const auto c = attack::valid(seed, contended(seed));
    if (!c) continue;
    ++made;
    const auto tightened = [&](Fault fault) {
      attack::Case of = *c;
      attack::tighten(of, seed, seed % 3 == 0,
                      [&](attack::Case& next) { return accepts(next, fault); });
      return of;
    };
    const attack::Case good = tightened(Fault::kNone);
    const auto attacked = [&](const attack::Case& of, attack::Early rule) {
      return attack::attack(of.app, of.platform, of.policy, {15'000, seed, rule});
    };
    const attack::Found found = attacked(good, attack::Early::kByTheRule);
    EXPECT_FALSE(found.broken()) << seed << ": " << found.late << found.chain;
    early += attacked(good, attack::Early::kOfItsXpu).broken() ? 1 : 0;
    for (const auto& [fault, name] : wrong)
      broken[fault] += attacked(tightened(fault), attack::Early::kByTheRule).broken() ? 1 : 0;
    const auto played = play(good.app, good.platform, good.policy, {1, true, true, true, seed});
    ASSERT_TRUE(played) << played.error().to_string();
    EXPECT_EQ(played->late, 0) << seed << ": " << played->first_late;
  }
  EXPECT_GE(made, 60);
  std::printf("early, other XPUs ignored: %d of %d broken\n", early, made);
  EXPECT_GE(early, 1);
  for (const auto& [fault, name] : wrong) {
    std::printf("%s: %d of %d broken\n", name, broken[fault], made);
    EXPECT_GE(broken[fault], 1) << name;
  }
}

TEST(KeysContention, TheSolversPoliciesHoldAndItKeepsSomeApart) {
  int made = 0, apart = 0, all = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    auto c = attack::valid(seed, contended(seed));
    if (!c) continue;
    Options options;
    options.max_evaluations = 300;
    options.time_limit_s = 60;
    options.seed = seed;
    const auto answer = solve(c->app, c->platform, options);
    ASSERT_TRUE(answer) << answer.error().to_string();
    if (answer->outcome != Outcome::kPolicy) continue;
    ++made;
    const auto checked = check(c->app, c->platform, answer->policy);
    EXPECT_TRUE(checked) << seed << ": " << checked.error().to_string();
    const auto found = attack::attack(c->app, c->platform, answer->policy, {15'000, seed});
    EXPECT_FALSE(found.broken()) << seed << ": " << found.late << found.chain;
    for (std::size_t i = 0; i < c->app.xnodes.size(); ++i) {
      const Placement& placed = answer->policy.placements[i];
      if (!placed.wcet_us) continue;
      ++all;
      apart +=
          *placed.wcet_us < longest_wcet(c->app.xnodes[i], c->platform.xpus[at(placed.xpu)].type);
    }
  }
  std::printf("%d policies, %d of %d counted apart\n", made, apart, all);
  EXPECT_GE(made, 10);
  EXPECT_GE(apart, 5);
}

// ---- Every execution of tiny apps.

/// Two XPUs, whole microseconds. A job ends after any time up to what it takes beside those that it has met so far.
class Every {
 public:
  Every(const attack::Case& c, bool early, bool looks_at_others)
      : c_(c), early_(early), looks_(looks_at_others) {
    const std::size_t n = c.app.xnodes.size();
    planned_ = planned_starts_us(c.app, c.platform, c.policy).ordinary;
    const std::int64_t turn = 24, until = 2 * turn;
    for (std::size_t i = 0; i < n; ++i) {
      const std::int64_t period = period_of(i);
      for (std::int64_t k = 0; k * period < until; ++k) {
        const Placement& p = c.policy.placements[i];
        Job job;
        job.xnode = i;
        job.number = k;
        job.release = k * period;
        job.key = job.release + p.key_us[0];
        job.planned = planned_[i].empty() ? job.release : job.release + planned_[i][0];
        jobs_.push_back(job);
      }
    }
  }

  /// Whether some job of some execution ends after its key. `states`: that were looked at.
  [[nodiscard]] bool late(std::size_t& states) {
    State first;
    first.jobs.assign(jobs_.size(), {});
    std::vector<State> open = {first};
    while (!open.empty()) {
      State s = std::move(open.back());
      open.pop_back();
      if (!seen_.insert(s).second) continue;
      ++states;
      if (states > 400'000) return false;
      if (step(s, open)) return true;
    }
    return false;
  }

 private:
  struct Job {
    std::size_t xnode = 0;
    std::int64_t number = 0, release = 0, key = 0, planned = 0;
  };
  struct Of {
    std::int8_t ran = 0;      ///< -1: it has ended
    std::int8_t met = 0;      ///< the other XPU
    std::int8_t started = 0;  ///< what does not preempt goes on with it
    auto operator<=>(const Of&) const = default;
  };
  struct State {
    std::int64_t now = 0;
    std::vector<Of> jobs;
    std::vector<int> running = {-1, -1};
    auto operator<=>(const State&) const = default;
  };
  [[nodiscard]] std::int64_t period_of(std::size_t i) const {
    if (!c_.app.xnodes[i].sources.empty())
      return c_.app.sources[at(c_.app.xnodes[i].sources[0])].period.num;
    for (const auto& [u, v] : c_.app.edges)
      if (at(v) == i) return period_of(at(u));
    return 0;
  }
  [[nodiscard]] std::int64_t takes(const Job& job, bool met) const {
    const XNodeSpec& x = c_.app.xnodes[job.xnode];
    const int m = c_.policy.placements[job.xnode].xpu;
    Load load;
    if (met) load[c_.platform.xpus[at(1 - m)].type] = 1;
    return std::max(*wcet_beside(x, c_.platform.xpus[at(m)].type, load),
                    c_.policy.placements[job.xnode].wcet_us.value_or(0));
  }
  [[nodiscard]] bool counts_apart(std::size_t i) const {
    const auto& beside = c_.app.xnodes[i].beside;
    return !beside.empty() && c_.policy.placements[i].wcet_us < beside[0].wcet_us;
  }
  [[nodiscard]] bool ended(const State& s, std::size_t xnode, std::int64_t number) const {
    for (std::size_t k = 0; k < jobs_.size(); ++k)
      if (jobs_[k].xnode == xnode && jobs_[k].number == number) return s.jobs[k].ran < 0;
    return true;
  }
  [[nodiscard]] bool may_start_early(const State& s, const Job& job) const {
    if (!early_) return false;
    const int m = c_.policy.placements[job.xnode].xpu;
    for (std::size_t k = 0; k < jobs_.size(); ++k) {
      const Job& other = jobs_[k];
      if (s.jobs[k].ran < 0 || other.xnode == job.xnode) continue;
      const int on = c_.policy.placements[other.xnode].xpu;
      if (on == m && !c_.platform.xpus[at(m)].preemptive && other.key <= job.key) return false;
      if (on != m && looks_ && (counts_apart(job.xnode) || counts_apart(other.xnode)) &&
          other.key <= job.planned)
        return false;
    }
    return true;
  }
  [[nodiscard]] bool ready(const State& s, std::size_t k) const {
    const Job& job = jobs_[k];
    if (s.jobs[k].ran < 0 || s.now < job.release) return false;
    if (s.jobs[k].started) return true;
    if (job.number > 0 && !ended(s, job.xnode, job.number - 1)) return false;
    for (const auto& [u, v] : c_.app.edges)
      if (at(v) == job.xnode && !ended(s, at(u), job.number)) return false;
    return s.now >= job.planned || may_start_early(s, job);
  }

  /// True: a job is late. All that may come of it is added to `open`.
  bool step(const State& s, std::vector<State>& open) {
    // Each running job may end now, or has to.
    for (int ends = 0; ends < 4; ++ends) {
      State next = s;
      bool possible = true;
      for (int m = 0; m < 2 && possible; ++m) {
        const int k = s.running[at(m)];
        const bool end = (ends >> m & 1) != 0;
        if (k < 0) {
          possible = !end;
          continue;
        }
        const Of& of = s.jobs[at(k)];
        if (end) {
          if (s.now > jobs_[at(k)].key) return true;
          next.jobs[at(k)] = {-1, 0, 0};
          next.running[at(m)] = -1;
        } else {
          possible = of.ran < takes(jobs_[at(k)], of.met != 0);
        }
      }
      if (possible) go_on(next, open);
    }
    return false;
  }

  void go_on(State& next, std::vector<State>& open) const {
    for (int m = 0; m < 2; ++m) {
      int& runs = next.running[at(m)];
      if (runs >= 0 && !c_.platform.xpus[at(m)].preemptive) continue;
      int best = runs;
      for (std::size_t k = 0; k < jobs_.size(); ++k)
        if (c_.policy.placements[jobs_[k].xnode].xpu == m && ready(next, k) &&
            (best < 0 || jobs_[k].key < jobs_[at(best)].key))
          best = static_cast<int>(k);
      runs = best;
    }
    const bool both = next.running[0] >= 0 && next.running[1] >= 0;
    for (const int k : next.running) {
      if (k < 0) continue;
      Of& of = next.jobs[at(k)];
      of.started = 1;
      if (both) of.met = 1;
      ++of.ran;
    }
    ++next.now;
    if (next.now < 4 * 24) open.push_back(next);
  }

  const attack::Case& c_;
  bool early_, looks_;
  std::vector<std::vector<std::int64_t>> planned_;
  std::vector<Job> jobs_;
  std::set<State> seen_;
};

/// Two XNodes on one XPU, two on the other one; keys as small as the check, or one with a fault, lets them be.
attack::Case tiny(std::uint64_t seed) {
  std::mt19937 random(static_cast<std::uint32_t>(seed));
  const auto pick = [&](int low, int high) {
    return static_cast<std::int64_t>(
        low + static_cast<int>(random() % static_cast<unsigned>(high - low + 1)));
  };
  attack::Case c;
  const bool preemptive = pick(0, 1) == 1;
  c.platform = {"p", {{"gpu0", "gpu", preemptive, 0}, {"dla0", "dla", pick(0, 1) == 1, 0}}};
  c.app.name = "tiny";
  for (int i = 0; i < 4; ++i) {
    XNodeSpec x;
    x.name = x.module = "x" + std::to_string(i);
    const bool second = i == 3 && pick(0, 1) == 1;  // after an XNode of the other XPU
    const std::string on = i % 2 == 0 ? "gpu" : "dla", other = i % 2 == 0 ? "dla" : "gpu";
    const std::int64_t alone = pick(1, 3);
    x.wcet_us[on] = alone;
    if (pick(0, 4) > 0) x.beside = {{on, {{other, 1}}, alone + pick(1, 3)}};
    if (second) {
      c.app.edges.emplace_back(0, 3);
    } else {
      x.sources = {static_cast<int>(c.app.sources.size())};
      c.app.sources.push_back({"s" + std::to_string(i), {pick(0, 2) == 0 ? 12 : 24, 1}});
    }
    c.app.modules.push_back({x.module, 1, false});
    c.app.xnodes.push_back(x);
    Placement placed;
    placed.xpu = i % 2;
    placed.key_us = {second ? c.policy.placements[0].key_us[0] + 8 : pick(6, 12)};
    c.policy.placements.push_back(placed);
  }
  for (int i = 0; i < 4; ++i) {
    Placement& placed = c.policy.placements[at(i)];
    if (pick(0, 1) == 1) placed.hold_us = {pick(1, 7)};
    const int source = c.app.xnodes[at(i)].sources.empty() ? c.app.xnodes[0].sources[0]
                                                           : c.app.xnodes[at(i)].sources[0];
    c.app.chains.push_back({"c" + std::to_string(i), source, i, {}, 1});
    c.policy.chains.push_back({"c" + std::to_string(i), 900'000'000'000, 0, false});
  }
  c.policy.app = c.app.name;
  c.policy.app_hash = c.app.hash();
  c.policy.platform = c.platform.name;
  return c;
}

TEST(KeysContention, OfTinyAppsNoExecutionAtAllIsLate) {
  int made = 0, apart = 0, found = 0, early = 0;
  std::size_t states = 0;
  for (std::uint64_t seed = 1; seed <= 600; ++seed) {
    const attack::Case c = tiny(seed);
    const auto tightened = [&](Fault fault) {
      std::optional<attack::Case> of = c;
      if (!accepts(*of, fault)) return std::optional<attack::Case>();
      attack::tighten(*of, seed, false, [&](attack::Case& next) { return accepts(next, fault); });
      return of;
    };
    if (const auto good = tightened(Fault::kNone)) {
      ++made;
      for (std::size_t i = 0; i < 4; ++i)
        apart += !good->app.xnodes[i].beside.empty() &&
                 good->policy.placements[i].wcet_us < good->app.xnodes[i].beside[0].wcet_us;
      EXPECT_FALSE(Every(*good, true, true).late(states)) << seed;
      EXPECT_FALSE(Every(*good, false, true).late(states)) << seed;
      early += Every(*good, true, false).late(states) ? 1 : 0;
    }
    if (const auto wrong = tightened(Fault::kFast))
      found += Every(*wrong, true, true).late(states) ? 1 : 0;
  }
  std::printf("%d apps, %zu states; %d counted apart; wrong: fast %d, early %d\n", made, states,
              apart, found, early);
  EXPECT_GE(made, 150);
  EXPECT_GE(apart, 60);
  EXPECT_GE(found, 50);
  EXPECT_GE(early, 3);
}

}  // namespace
}  // namespace xauto::solver::keys::test::contention
